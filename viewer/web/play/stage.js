import { CanvasRenderer } from "../draw/renderer.js";
import { cameraOf } from "../navigate/pose.js";
import { selectSourceViews } from "../navigate/source_views.js";
import { Playback } from "./playback.js";
import { Quality } from "./quality.js";
/** @typedef {import("../scene/manifest.js").Camera} Camera */
/** @typedef {import("../navigate/pose.js").Pose} Pose */

/** Time in milliseconds without motion after which the image is drawn at full resolution. */
const REST_MS = 250;

/** Dark grey, on which black parts of a subject are visible. @type {[number, number, number]} */
export const DEFAULT_BACKGROUND = [0.09, 0.094, 0.102];

/** Plays a scene in a canvas, which is drawn only if something has changed. */
export class Stage {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {import("../scene/scene_file.js").SceneFile} file
   * @param {import("../decode/pool.js").DecodePool} pool
   * @param {Pose} pose
   * @param {(error: unknown) => void} failed
   */
  constructor(canvas, file, pool, pose, failed) {
    this.canvas = canvas;
    this.manifest = file.manifest;
    /** @type {CanvasRenderer | null} */
    this.renderer = new CanvasRenderer(canvas, this.manifest);
    this.playback = new Playback(file, pool, () => (this.isDirty = true), failed);
    this.store = this.playback.store;
    this.clock = this.playback.clock;
    this.quality = new Quality();
    this.pose = pose;
    /** A camera that replaces the pose, for exact comparisons. @type {Camera | null} */
    this.fixedCamera = null;
    /** @type {import("../draw/renderer.js").Mode} */
    this.mode = "sorted";
    this.layers = this.manifest.layers;
    /** @type {[number, number, number]} */
    this.background = DEFAULT_BACKGROUND;
    /** @type {import("../draw/renderer.js").ReadyStyle | null} */
    this.style = null;
    /** How many more times a paused frame is drawn, so that the lines of a style can fade in. */
    this.fading = 0;
    this.isDirty = true;
    /** Whether another program draws the scene, so that nothing is drawn into the canvas. */
    this.isSuspended = false;
    this.movedAt = 0;
    this.hasDrawn = false;
    this.images = 0;
    this.drawnScale = 0;
  }

  /** @param {Pose} pose */
  setPose(pose) {
    this.pose = pose;
    this.fixedCamera = null;
    this.movedAt = performance.now();
    this.isDirty = true;
  }

  /**
   * Draws the scene in a style. Until the normals are loaded, the scene is drawn without a style.
   * @param {import("../draw/renderer.js").ReadyStyle | null} style
   */
  setStyle(style) {
    this.style = style;
    this.playback.needsNormals = style !== null;
    this.isDirty = true;
  }

  /** The depth order with which the last image was drawn. */
  get order() {
    return this.playback.order;
  }

  /** Whether playback waits for the network. */
  get isWaiting() {
    return this.playback.isWaiting;
  }

  /** Whether the image shows the current time and view at full resolution, with all source views. */
  get isSettled() {
    return !this.isDirty && this.fading === 0 && this.drawnScale === 1 && this.playback.isSettled(this.camera(1));
  }

  /**
   * Advances the time and draws if something has changed. Called once per displayed image.
   * @param {number} now In milliseconds.
   * @param {number} elapsed Seconds since the last call.
   */
  update(now, elapsed) {
    if (this.isSuspended) return;
    const isMoving = this.clock.isPlaying || now - this.movedAt < REST_MS;
    // `elapsed` measures the drawing time, because browsers delay the next call until the graphics driver has finished
    // the last image.
    if (!isMoving) this.quality.rest();
    else if (this.hasDrawn) this.quality.report(1000 * elapsed);
    this.hasDrawn = false;
    const scale = isMoving ? this.quality.scale : 1;
    const camera = this.camera(scale);
    this.playback.update(elapsed, camera);
    const hasChanged = this.isDirty || scale !== this.drawnScale;
    if (!hasChanged && this.fading === 0) return;
    if (!this.order || !this.renderer) return;
    this.#draw(camera);
    if (this.clock.isPlaying) this.fading = 0;
    else this.fading = hasChanged ? imagesOfFade(this.style) : this.fading - 1;
    this.hasDrawn = true;
    this.drawnScale = scale;
    this.isDirty = false;
    this.images++;
  }

  /** Draws again without waiting, so that the canvas can be read in the same task. */
  redraw() {
    this.#draw(this.camera(1));
  }

  /**
   * Returns the camera for an image whose width and height are the canvas' times `scale`.
   * @param {number} scale
   * @returns {Camera}
   */
  camera(scale) {
    if (this.fixedCamera) return this.fixedCamera;
    const width = Math.max(Math.round(this.canvas.width * scale), 1);
    const height = Math.max(Math.round(this.canvas.height * scale), 1);
    return cameraOf(this.pose, width, height);
  }

  /** Discards all graphics objects after the WebGL context was lost. */
  loseContext() {
    this.renderer = null;
  }

  /** Creates the graphics objects again. */
  restoreContext() {
    this.renderer = new CanvasRenderer(this.canvas, this.manifest);
    this.isDirty = true;
  }

  release() {
    this.renderer?.release();
    this.renderer = null;
    this.playback.release();
  }

  /** @param {Camera} camera */
  #draw(camera) {
    const picture = this.playback.picture(camera, selectSourceViews(camera, this.manifest));
    if (!picture || !this.renderer) return;
    this.renderer.draw({ ...picture, layers: this.layers }, this.mode, this.background, this.style);
  }
}

/**
 * Returns the number of images after which the strength of a line that fades in is within 1/255 of its final value.
 * @param {import("../draw/renderer.js").ReadyStyle | null} ready
 */
function imagesOfFade(ready) {
  const persistence = ready?.style.persistence ?? 0;
  return persistence > 0 ? Math.ceil(Math.log(1 / 255) / Math.log(persistence)) : 0;
}
