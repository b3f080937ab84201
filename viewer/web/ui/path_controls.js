import { CameraPath } from "../navigate/camera_path.js";
import { setIcon } from "./icons.js";
/** @typedef {import("../fourd-player.js").FourdPlayer} FourdPlayer */
/** @typedef {import("../navigate/pose.js").Pose} Pose */

/** Makes a camera path from the views that the user chooses, plays it, and saves it as a file. */
export class PathControls {
  /** @param {FourdPlayer} player */
  constructor(player) {
    this.player = player;
    this.path = new CameraPath();
    this.isPlaying = false;
    this.seconds = 0;
    /** The pose that was shown last while the path was played. Another pose is one that the user has chosen.
     * @type {Pose | null} */
    this.shown = null;
    /** @type {import("../play/stage.js").Stage | null} */
    this.stage = null;
    const { addKey, playPath, savePath } = player.panel;
    addKey.addEventListener("click", () => this.add());
    playPath.addEventListener("click", () => this.toggle());
    savePath.addEventListener("click", () => this.save());
    this.#show();
  }

  /** Adds the view and the frame to the end of the path. */
  add() {
    const { stage, panel } = this.player;
    if (!stage) return;
    this.#stop();
    this.path.add(stage.pose, stage.clock.frame);
    panel.showNote(`Key frame ${this.path.keys.length} of the camera path.`);
    this.#show();
  }

  /** Plays the path from its start, or stops it. */
  toggle() {
    if (this.isPlaying || this.path.keys.length === 0) return this.#stop();
    this.isPlaying = true;
    this.seconds = 0;
    this.shown = this.player.stage?.pose ?? null;
    this.#show();
  }

  /** Saves the path as a file that `fourd render --path` reads. */
  save() {
    const content = JSON.stringify(this.path.toJson(), null, 1);
    const name = (this.player.getAttribute("src") ?? "scene").split(/[?#]/)[0].split("/").pop() || "scene";
    const anchor = document.createElement("a");
    anchor.href = URL.createObjectURL(new Blob([content], { type: "application/json" }));
    anchor.download = `${name.replace(/\.4dv$/, "")}.path.json`;
    anchor.click();
    setTimeout(() => URL.revokeObjectURL(anchor.href), 10000);
  }

  /**
   * Moves the view along the path while it is played, until it ends or the user moves the view.
   * @param {number} elapsed In seconds.
   */
  update(elapsed) {
    const { stage } = this.player;
    if (stage !== this.stage) {
      this.stage = stage;
      this.#stop();
    }
    if (!this.isPlaying || !stage) return;
    if (stage.pose !== this.shown) return this.#stop();
    this.seconds = Math.min(this.seconds + elapsed, this.path.duration);
    const { pose, frame } = this.path.at(this.seconds);
    this.player.seek(frame);
    stage.setPose(pose);
    this.shown = pose;
    if (this.seconds === this.path.duration) this.#stop();
  }

  #stop() {
    this.isPlaying = false;
    this.#show();
  }

  #show() {
    const { playPath, savePath } = this.player.panel;
    playPath.hidden = savePath.hidden = this.path.keys.length === 0;
    setIcon(playPath, this.isPlaying ? "stopPath" : "playPath");
  }
}
