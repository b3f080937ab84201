import "../fourd-player.js";
import { EmbeddedSource, KernelSource, toBytes } from "./sources.js";
/** @typedef {import("../fourd-player.js").FourdPlayer} FourdPlayer */
/** @typedef {import("./sources.js").Model} Model */

const SILENT = "The kernel does not answer: it is busy or has ended. Wait, or run the cell again.";

/**
 * Shows the scene of a widget in an element of the notebook.
 * @param {{model: Model, el: HTMLElement}} place
 * @returns {() => void} Removes the player.
 */
function render({ model, el }) {
  // The page may have the class of an earlier widget's code, so that the element is made by its name.
  const player = /** @type {FourdPlayer} */ (document.createElement("fourd-player"));
  const poster = URL.createObjectURL(new Blob([toBytes(model.get("poster")).slice()], { type: "image/png" }));
  /** @type {Set<KernelSource | EmbeddedSource>} */
  const sources = new Set();
  player.makeSource = (name) => {
    for (const source of sources) source.release();
    sources.clear();
    const bytes = model.get("scene");
    const source = bytes
      ? new EmbeddedSource(toBytes(bytes), name)
      : new KernelSource(model, name, model.get("size"), () => player.panel.showNote(SILENT));
    sources.add(source);
    return source;
  };
  for (const [name, value] of Object.entries({ src: model.get("name"), poster, embedded: "" })) {
    player.setAttribute(name, value);
  }
  if (model.get("autoplay")) player.setAttribute("autoplay", "");
  player.setAttribute("aria-label", `4D scene ${model.get("name")}`);
  // Keys of the player must not edit the notebook.
  player.setAttribute("data-lm-suppress-shortcuts", "true");
  player.addEventListener("keydown", (event) => event.stopPropagation());
  /** @type {[string, () => void][]} */
  const followed = [
    ["change:frame", () => model.get("frame") !== null && player.seek(model.get("frame"))],
    ["change:background", () => setBackground(player, model.get("background"))],
    ["change:height", () => (player.style.height = `${model.get("height")}px`)],
  ];
  for (const [name, follow] of followed) model.on(name, follow);
  for (const [, follow] of followed.slice(1)) follow();
  player.addEventListener("ready", followed[0][1], { once: true });
  el.append(player);
  return () => {
    for (const [name, follow] of followed) model.off(name, follow);
    player.remove();
    for (const source of sources) source.release();
    URL.revokeObjectURL(poster);
  };
}

/**
 * @param {FourdPlayer} player
 * @param {string | null} colour
 */
function setBackground(player, colour) {
  if (colour) player.setAttribute("background", colour);
  else player.removeAttribute("background");
}

export const widget = { render };
