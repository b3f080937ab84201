import { Refusal, sendRequest } from "./client.js";
import { buttonById, byId, setText } from "./elements.js";
/** @typedef {import("./client.js").Status} Status */

/** Maximum time in milliseconds that the page waits for a button to take effect. */
const PATIENCE_MS = 120000;

const CONTINUE = "Continue it with fourd train --resume, or with the fourd make command that started it.";

const WAITING = {
  pause: "Waiting for the end of the step …",
  resume: "Resuming …",
  save: "Saved after the current step.",
  stop: "Stopping after the current step …",
};

/** The buttons that control the training. */
export class Controls {
  /** @param {() => void} refresh Requests the state from the server. */
  constructor(refresh) {
    this.pause = buttonById("pause");
    this.save = buttonById("save");
    this.stop = buttonById("stop");
    this.note = byId("note");
    this.refresh = refresh;
    /** @type {Status | null} */
    this.status = null;
    /** The request that has not taken effect yet. @type {{phase: string, until: number} | null} */
    this.pending = null;
    this.pause.addEventListener("click", () => this.#send(this.status?.phase === "paused" ? "resume" : "pause"));
    this.save.addEventListener("click", () => this.#send("save"));
    this.stop.addEventListener("click", () => {
      if (confirm("Stop the training? It is saved, and can be continued later.")) this.#send("stop");
    });
  }

  /** @param {Status} status */
  show(status) {
    this.status = status;
    const { phase } = status;
    if (this.pending && (this.pending.phase !== phase || performance.now() > this.pending.until)) {
      this.pending = null;
      setText(this.note, "");
    }
    const isRunning = phase === "training" || phase === "paused";
    this.pause.disabled = this.stop.disabled = !isRunning || this.pending !== null;
    this.save.disabled = phase !== "training" || this.pending !== null;
    setText(this.pause, phase === "paused" ? "Resume" : "Pause");
    if (!this.pending) setText(this.note, explain(status));
  }

  /** @param {keyof typeof WAITING} action */
  async #send(action) {
    if (!this.status) return;
    try {
      await sendRequest(this.status.session, action);
      setText(this.note, WAITING[action]);
      this.pending = { phase: this.status.phase, until: performance.now() + (action === "save" ? 4000 : PATIENCE_MS) };
      this.show(this.status);
    } catch (error) {
      if (!(error instanceof Refusal)) throw error;
      setText(this.note, error.message);
      this.pending = { phase: this.status.phase, until: performance.now() + 6000 };
    }
    setTimeout(this.refresh, 700);
  }
}

/**
 * Returns a text that tells the user how to continue a run that is not training.
 * @param {Status} status
 */
function explain(status) {
  switch (status.phase) {
    case "paused":
      return "The training is saved and waits.";
    case "stopped":
      return `The training is saved. ${CONTINUE}`;
    case "failed":
      return status.reason;
    case "ended":
      return `The training's process ended without a message. ${CONTINUE}`;
    case "idle":
      return "No training of this run is known.";
    default:
      return "";
  }
}
