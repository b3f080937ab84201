import { Chart } from "./chart.js";
/** @typedef {import("./chart.js").Curve} Curve */
/** @typedef {import("./client.js").Series} Series */

const LOSS = "loss/";

/** The charts of a run. */
export class Curves {
  /** @param {HTMLElement} parent */
  constructor(parent) {
    this.psnr = new Chart("PSNR in dB", { isLog: false, key: "psnr" });
    this.losses = new Chart("Loss terms", { isLog: true, key: "losses" });
    parent.append(this.psnr.element, this.losses.element);
  }

  /**
   * @param {Record<string, Series>} series
   * @param {boolean} isHeldOut
   */
  show(series, isHeldOut) {
    const views = isHeldOut ? "held-out views" : "validation views";
    this.psnr.show([
      ...curve(series["psnr"], { label: "training views", colour: 0, isThin: true }),
      ...curve(series["psnr_smooth"], { label: "training views, smoothed", colour: 0 }),
      ...curve(series["validation/psnr"], { label: views, colour: 1, hasDots: true }),
      ...curve(series["validation/training_psnr"], { label: "training views, validated", colour: 2, hasDots: true }),
    ]);
    const names = Object.keys(series).filter((name) => name.startsWith(LOSS));
    const losses = names.map((name, colour) => curve(series[name], { label: name.slice(LOSS.length), colour }));
    this.losses.show(losses.flat());
  }
}

/**
 * Returns a list with one curve, or an empty list if the series has no values.
 * @param {Series | undefined} series
 * @param {Omit<Curve, "step" | "value">} style
 * @returns {Curve[]}
 */
function curve(series, style) {
  return series && series.step.length > 0 ? [{ ...style, ...series }] : [];
}
