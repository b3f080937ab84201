import { byId, setText } from "./elements.js";
import { formatDuration } from "./scale.js";
/** @typedef {import("./client.js").Status} Status */

/** @type {Record<Status["phase"], string>} */
const PHASES = {
  training: "training",
  paused: "paused",
  finished: "finished",
  stopped: "stopped",
  failed: "failed",
  ended: "ended",
  idle: "not training",
};

const NEW_VIEWS = "Quality of new views";

/**
 * Shows the phase, the progress and the numbers of a run.
 * @param {Status} status
 */
export function showStatus(status) {
  const phase = byId("phase");
  setText(phase, PHASES[status.phase]);
  phase.className = `phase ${status.phase}`;
  const bar = /** @type {HTMLProgressElement} */ (byId("spent"));
  bar.value = status.spent ?? 0;
  bar.hidden = status.spent === null;
  const numbers = numbersOf(status);
  const list = byId("numbers");
  if (list.children.length !== numbers.length) list.replaceChildren(...numbers.map(([name]) => makeEntry(name)));
  numbers.forEach(([name, value], i) => {
    setText(list.children[i].children[0], name);
    setText(list.children[i].children[1], value);
  });
  const psnr = formatPsnr(status.validation_psnr ?? status.psnr);
  document.title = `${status.title}: ${PHASES[status.phase]}, step ${status.step}, ${psnr}`;
}

/**
 * @param {Status} status
 * @returns {[string, string][]}
 */
function numbersOf(status) {
  const step = status.step.toLocaleString("en");
  const views = status.is_held_out ? "PSNR, held-out views" : "PSNR, validation views";
  /** @type {[string, string][]} */
  const numbers = [
    ["Step", status.max_steps === null ? step : `${step} of ${status.max_steps.toLocaleString("en")}`],
    [views, formatPsnr(status.validation_psnr)],
    ["PSNR, training views", formatPsnr(status.psnr)],
    ["Training time", formatDuration(status.seconds)],
    ["Time left", status.remaining_seconds === null ? "–" : formatDuration(status.remaining_seconds)],
  ];
  if (status.held_out !== "") numbers.push([NEW_VIEWS, status.held_out.replace(/^held out: /, "")]);
  if (status.segment !== null) numbers.unshift(["Segment", String(status.segment)]);
  if (status.broken_lines > 0) numbers.push(["Unreadable lines of the log", String(status.broken_lines)]);
  return numbers;
}

/** @param {number | null} psnr */
function formatPsnr(psnr) {
  return psnr === null ? "–" : `${psnr.toFixed(2)} dB`;
}

/** @param {string} name */
function makeEntry(name) {
  const entry = document.createElement("div");
  entry.classList.toggle("sentence", name === NEW_VIEWS);
  entry.append(document.createElement("dt"), document.createElement("dd"));
  return entry;
}
