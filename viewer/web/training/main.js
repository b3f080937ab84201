import { Refusal, fetchCurves, fetchStatus } from "./client.js";
import { Controls } from "./controls.js";
import { Curves } from "./curves.js";
import { byId } from "./elements.js";
import { Pictures } from "./pictures.js";
import { SceneTab } from "./scene_tab.js";
import { showStatus } from "./summary.js";

const POLL_MS = 2000;
/** Time in milliseconds between two requests while the run does not train. */
const IDLE_POLL_MS = 5000;

/** Requests the state of a run from the server regularly, and shows it. */
class TrainingPage {
  constructor() {
    this.curves = new Curves(byId("charts"));
    this.pictures = new Pictures(byId("pictures"));
    this.controls = new Controls(() => this.#poll());
    this.scene = new SceneTab();
    /** The state for which the current curves were requested. */
    this.shown = "";
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.timer = undefined;
    // A hidden page sends no requests. When it is shown again, it sends a request at once.
    document.addEventListener("visibilitychange", () => document.hidden || this.#poll());
  }

  start() {
    this.#poll();
  }

  async #poll() {
    clearTimeout(this.timer);
    let delay = IDLE_POLL_MS;
    try {
      const status = await fetchStatus();
      showStatus(status);
      this.controls.show(status);
      this.pictures.show(status.pictures, status.segment);
      const version = `${status.session} ${status.segment} ${status.step} ${status.phase}`;
      if (version !== this.shown) {
        this.curves.show(await fetchCurves(), status.is_held_out);
        this.shown = version;
      }
      showProblem("");
      if (status.phase === "training" || status.phase === "paused") delay = POLL_MS;
    } catch (error) {
      if (!(error instanceof Refusal)) throw error;
      showProblem(error.message);
    } finally {
      clearTimeout(this.timer);
      if (!document.hidden) this.timer = setTimeout(() => this.#poll(), delay);
    }
  }
}

/** @param {string} text */
function showProblem(text) {
  const element = byId("problem");
  element.hidden = text === "";
  if (element.textContent !== text) element.textContent = text;
}

new TrainingPage().start();
