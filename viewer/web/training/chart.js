import { formatNumber, makeAxis } from "./scale.js";

const SVG = "http://www.w3.org/2000/svg";
const MARGIN = { left: 44, right: 10, top: 8, bottom: 22 };
const COLOURS = 8;

/**
 * A curve of a chart. Dots mark the values of curves with `hasDots`.
 * @typedef {{label: string, colour: number, isThin?: boolean, hasDots?: boolean, step: number[], value: number[]}} Curve
 */

/** A chart of curves over the training steps. It has axes and a legend, and shows the values at the pointer. */
export class Chart {
  /**
   * @param {string} title
   * @param {{isLog: boolean, key: string}} options `key` names the chart in the settings that the browser stores.
   */
  constructor(title, { isLog, key }) {
    this.title = title;
    this.element = document.createElement("section");
    this.element.className = "chart";
    const header = document.createElement("header");
    const heading = document.createElement("h2");
    heading.textContent = title;
    this.logSteps = checkbox("log steps", `${key} log steps`, false, () => this.#draw());
    this.logValues = checkbox("log values", `${key} log values`, isLog, () => this.#draw());
    header.append(heading, this.logSteps.label, this.logValues.label);
    this.plot = document.createElement("div");
    this.plot.className = "plot";
    this.svg = /** @type {SVGSVGElement} */ (svgElement("svg", { role: "img" }));
    this.values = document.createElement("div");
    this.values.className = "values";
    this.values.hidden = true;
    this.plot.append(this.svg, this.values);
    this.legend = document.createElement("ul");
    this.legend.className = "legend";
    this.element.append(header, this.plot, this.legend);
    /** @type {Curve[]} */
    this.curves = [];
    /** @type {((step: number) => number) | null} */
    this.position = null;
    /** Distance of the pointer from the left edge of the plot. @type {number | null} */
    this.pixel = null;
    const point = (/** @type {PointerEvent} */ event) => {
      this.pixel = event.clientX - this.plot.getBoundingClientRect().left;
      this.#showValues();
    };
    this.plot.addEventListener("pointermove", point);
    this.plot.addEventListener("pointerdown", point);
    this.plot.addEventListener("pointerleave", () => {
      this.pixel = null;
      this.#showValues();
    });
    new ResizeObserver(() => this.#draw()).observe(this.plot);
  }

  /** @param {Curve[]} curves */
  show(curves) {
    this.curves = curves;
    this.element.hidden = curves.length === 0;
    this.legend.replaceChildren(...curves.map(legendEntry));
    this.#draw();
  }

  #draw() {
    this.#drawCurves();
    this.#showValues();
  }

  #drawCurves() {
    const width = this.svg.clientWidth - MARGIN.left - MARGIN.right;
    const height = this.svg.clientHeight - MARGIN.top - MARGIN.bottom;
    this.svg.replaceChildren();
    this.position = null;
    const shown = this.curves.map((curve) => this.#drawable(curve)).filter((curve) => curve.step.length > 0);
    if (width <= 0 || height <= 0 || shown.length === 0) return;
    const [firstStep, lastStep] = range(shown.map((curve) => curve.step));
    const [least, largest] = range(shown.map((curve) => curve.value));
    const steps = makeAxis(firstStep, lastStep, width, this.logSteps.input.checked, Math.max(width / 60, 2));
    const values = makeAxis(least, largest, height, this.logValues.input.checked, Math.max(height / 36, 2));
    const x = (/** @type {number} */ step) => MARGIN.left + steps.position(step);
    const y = (/** @type {number} */ value) => MARGIN.top + height - values.position(value);
    for (const tick of values.ticks) {
      this.svg.append(line(MARGIN.left, MARGIN.left + width, y(tick), y(tick), "grid"));
      this.svg.append(label(formatNumber(tick), MARGIN.left - 6, y(tick) + 4, "end"));
    }
    for (const tick of steps.ticks) this.svg.append(label(formatNumber(tick), x(tick), MARGIN.top + height + 16, "middle"));
    for (const curve of shown) {
      const points = curve.step.map((step, i) => `${x(step).toFixed(1)} ${y(curve.value[i]).toFixed(1)}`);
      const style = `curve c${curve.colour % COLOURS}${curve.isThin ? " thin" : ""}`;
      this.svg.append(svgElement("path", { d: `M${points.join("L")}`, class: style }));
      const dots = curve.hasDots || curve.step.length === 1 ? curve.step : [];
      const dotStyle = `dot c${curve.colour % COLOURS}`;
      dots.forEach((step, i) => this.svg.append(svgElement("circle", { cx: x(step), cy: y(curve.value[i]), r: 2.5, class: dotStyle })));
    }
    this.svg.setAttribute("aria-label", `${this.title}: ${shown.map(describeLast).join(", ")}`);
    this.position = x;
  }

  /**
   * Returns the values of a curve that the axes can show. Logarithmic axes show only positive values.
   * @param {Curve} curve
   * @returns {Curve}
   */
  #drawable(curve) {
    const isShown = (/** @type {number} */ i) =>
      (!this.logSteps.input.checked || curve.step[i] > 0) && (!this.logValues.input.checked || curve.value[i] > 0);
    const kept = curve.step.map((_, i) => i).filter(isShown);
    return { ...curve, step: kept.map((i) => curve.step[i]), value: kept.map((i) => curve.value[i]) };
  }

  /** Shows the values at the pointer, or no values if the pointer is outside the plot. */
  #showValues() {
    const { position, pixel } = this;
    this.values.hidden = true;
    this.svg.querySelector(".cursor")?.remove();
    if (!position || pixel === null) return;
    const shown = this.curves.map((curve) => this.#drawable(curve)).filter((curve) => curve.step.length > 0);
    const nearest = shown.map((curve) => nearestIndex(curve.step, position, pixel));
    const distances = shown.map((curve, k) => Math.abs(position(curve.step[nearest[k]]) - pixel));
    const closest = distances.indexOf(Math.min(...distances));
    const step = shown[closest].step[nearest[closest]];
    const lines = shown.map((curve, k) => {
      const i = nearest[k];
      const isSame = Math.abs(position(curve.step[i]) - position(step)) < 2;
      return `${curve.label}: ${formatNumber(curve.value[i])}${isSame ? "" : ` (step ${formatStep(curve.step[i])})`}`;
    });
    const at = position(step);
    this.svg.append(line(at, at, MARGIN.top, this.svg.clientHeight - MARGIN.bottom, "grid cursor"));
    this.values.replaceChildren(...[`step ${formatStep(step)}`, ...lines].map(paragraph));
    this.values.hidden = false;
    const isLeft = at < this.svg.clientWidth / 2;
    this.values.style.left = isLeft ? `${at + 8}px` : "auto";
    this.values.style.right = isLeft ? "auto" : `${this.svg.clientWidth - at + 8}px`;
  }
}

/**
 * @param {number[]} steps
 * @param {(step: number) => number} position
 * @param {number} pixel
 */
function nearestIndex(steps, position, pixel) {
  let best = 0;
  steps.forEach((step, i) => {
    if (Math.abs(position(step) - pixel) < Math.abs(position(steps[best]) - pixel)) best = i;
  });
  return best;
}

/**
 * @param {number[][]} lists
 * @returns {[number, number]}
 */
function range(lists) {
  let least = Infinity;
  let largest = -Infinity;
  for (const list of lists) {
    for (const value of list) {
      least = Math.min(least, value);
      largest = Math.max(largest, value);
    }
  }
  return [least, largest];
}

/** @param {number} step */
function formatStep(step) {
  return Math.round(step).toLocaleString("en");
}

/** @param {Curve} curve */
function describeLast(curve) {
  return `${curve.label} ${formatNumber(curve.value[curve.value.length - 1])}`;
}

/** @param {Curve} curve */
function legendEntry(curve) {
  const entry = document.createElement("li");
  const swatch = document.createElement("span");
  swatch.className = `swatch c${curve.colour % COLOURS}${curve.isThin ? " thin" : ""}`;
  entry.append(swatch, curve.label);
  return entry;
}

/** @param {string} text */
function paragraph(text) {
  const made = document.createElement("div");
  made.textContent = text;
  return made;
}

/**
 * Creates a checkbox whose value the browser stores.
 * @param {string} text
 * @param {string} key
 * @param {boolean} isChecked
 * @param {() => void} changed
 */
function checkbox(text, key, isChecked, changed) {
  const input = document.createElement("input");
  input.type = "checkbox";
  const kept = readSetting(key);
  input.checked = kept === null ? isChecked : kept === "true";
  input.addEventListener("change", () => {
    keepSetting(key, String(input.checked));
    changed();
  });
  const made = document.createElement("label");
  made.append(input, ` ${text}`);
  return { input, label: made };
}

/** @param {string} key */
function readSetting(key) {
  try {
    return localStorage.getItem(`fourd ${key}`);
  } catch {
    return null; // Users can switch off the browser's storage.
  }
}

/**
 * @param {string} key
 * @param {string} value
 */
function keepSetting(key, value) {
  try {
    localStorage.setItem(`fourd ${key}`, value);
  } catch {
    // If the browser's storage is switched off, the setting is lost when the page is loaded again.
  }
}

/**
 * @param {string} name
 * @param {Record<string, string | number>} attributes
 */
function svgElement(name, attributes) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, String(value));
  return made;
}

/**
 * @param {number} x1
 * @param {number} x2
 * @param {number} y1
 * @param {number} y2
 * @param {string} style
 */
function line(x1, x2, y1, y2, style) {
  return svgElement("line", { x1, x2, y1, y2, class: style });
}

/**
 * @param {string} text
 * @param {number} x
 * @param {number} y
 * @param {string} anchor
 */
function label(text, x, y, anchor) {
  const made = svgElement("text", { x, y, "text-anchor": anchor });
  made.textContent = text;
  return made;
}
