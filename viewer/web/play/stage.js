import { Renderer } from "../draw/renderer.js";
import { cameraOf } from "../navigate/pose.js";
import { selectSourceViews } from "../navigate/source_views.js";
import { Sorter } from "../sort/sorter.js";
import { Clock } from "./clock.js";
import { BACKGROUND, FrameStore } from "./frame_store.js";
import { Quality } from "./quality.js";
/** @typedef {import("../scene/manifest.js").Camera} Camera */
/** @typedef {import("../navigate/pose.js").Pose} Pose */

const BUFFERED_FRAMES = 3;
const AHEAD_BYTES = 96 << 20;
const MAX_AHEAD = 24;
/** Time without motion after which the image is drawn at full resolution. */
const REST_MS = 250;

/** Plays a scene into a canvas: loads frames, sorts points, and draws when something has changed. */
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
    this.failed = failed;
    /** @type {Renderer | null} */
    this.renderer = new Renderer(canvas, this.manifest);
    this.store = new FrameStore(file, pool, () => (this.isDirty = true), failed);
    this.sorter = new Sorter();
    this.clock = new Clock(this.manifest.points.length, this.manifest.fps);
    this.quality = new Quality();
    this.pose = pose;
    /** A camera that replaces the pose, for exact comparisons. @type {Camera | null} */
    this.fixedCamera = null;
    /** @type {import("../draw/renderer.js").Mode} */
    this.mode = "sorted";
    this.layers = this.manifest.layers;
    /** @type {[number, number, number]} */
    this.background = [0, 0, 0];
    this.isDirty = true;
    this.isWaiting = true;
    this.movedAt = 0;
    this.hasDrawn = false;
    this.images = 0;
    this.drawnScale = 0;
    /** The depth order that is drawn. @type {(import("../sort/sorter.js").SortedPoints & {frame: number, camera: Camera}) | null} */
    this.order = null;
    this.cloudNumbers = new WeakMap();
    this.cloudCount = 0;
    const fetched = Math.max(...this.manifest.points, 1) * (18 + 2 * this.manifest.dynamicEncoding.shRows);
    this.ahead = Math.min(Math.max(Math.floor(AHEAD_BYTES / fetched), 4), MAX_AHEAD);
  }

  /** @param {Pose} pose */
  setPose(pose) {
    this.pose = pose;
    this.fixedCamera = null;
    this.movedAt = performance.now();
    this.isDirty = true;
  }

  /** Whether the image shows the current time and view at full resolution, with all source views. */
  get isSettled() {
    const { order, clock } = this;
    if (!order || this.isDirty || this.sorter.isBusy) return false;
    return order.frame === clock.frame && this.store.isComplete(clock.frame) && this.#isSorted() && this.drawnScale === 1;
  }

  /**
   * Advances the time and draws if something has changed. Called once per displayed image.
   * @param {number} now In milliseconds.
   * @param {number} elapsed Seconds since the last call.
   */
  update(now, elapsed) {
    this.#advance(elapsed);
    const isMoving = this.clock.isPlaying || now - this.movedAt < REST_MS;
    // Browsers delay the next call if the graphics driver has not finished the last image.
    if (!isMoving) this.quality.rest();
    else if (this.hasDrawn) this.quality.report(1000 * elapsed);
    this.hasDrawn = false;
    const scale = isMoving ? this.quality.scale : 1;
    const camera = this.camera(scale);
    const selection = selectSourceViews(camera, this.manifest);
    const frame = this.clock.frame;
    this.store.want([frame, ...this.clock.upcoming(this.clock.isPlaying ? this.ahead : 2)], selection.views);
    this.#sort(frame, camera);
    if (!this.isDirty && scale === this.drawnScale) return;
    if (!this.order || !this.renderer) return;
    this.#draw(camera, selection);
    this.hasDrawn = true;
    this.drawnScale = scale;
    this.isDirty = false;
    this.images++;
  }

  /** Draws again without waiting, so that the canvas can be read in the same task. */
  redraw() {
    const camera = this.camera(1);
    if (this.order && this.renderer) this.#draw(camera, selectSourceViews(camera, this.manifest));
  }

  /**
   * The camera for a fraction of the canvas' width and height.
   * @param {number} scale
   * @returns {Camera}
   */
  camera(scale) {
    if (this.fixedCamera) return this.fixedCamera;
    const width = Math.max(Math.round(this.canvas.width * scale), 1);
    const height = Math.max(Math.round(this.canvas.height * scale), 1);
    return cameraOf(this.pose, width, height);
  }

  /** Forgets all graphics objects, after the WebGL context was lost. */
  loseContext() {
    this.renderer = null;
  }

  /** Creates the graphics objects again. */
  restoreContext() {
    this.renderer = new Renderer(this.canvas, this.manifest);
    this.isDirty = true;
  }

  release() {
    this.renderer?.release();
    this.renderer = null;
    this.sorter.release();
    this.store.release();
  }

  /** @param {number} elapsed */
  #advance(elapsed) {
    const { clock, store } = this;
    if (!clock.isPlaying) {
      this.isWaiting = !store.isComplete(clock.frame);
      return;
    }
    const { seconds } = clock;
    if (this.isWaiting && ![clock.frame, ...clock.upcoming(BUFFERED_FRAMES)].every((frame) => store.isComplete(frame))) {
      return;
    }
    clock.advance(Math.min(elapsed, 0.25));
    this.isWaiting = !store.isComplete(clock.frame);
    if (this.isWaiting) clock.seconds = seconds;
  }

  /**
   * @param {number} frame
   * @param {Camera} camera
   */
  #sort(frame, camera) {
    if (this.sorter.isBusy || !this.store.isDrawable(frame) || this.#isSorted()) return;
    const clouds = this.#clouds(frame).flatMap((cloud, index) => {
      const first = index ? (this.renderer?.textures.backgroundFirst ?? 0) : 0;
      return cloud ? [{ cloud: this.#numberOf(cloud.base), first, radius: cloud.base.largestRadius, xyz: cloud.base.xyz }] : [];
    });
    const border = Math.max(camera.width, camera.height) / 2;
    const sorted = this.sorter.sort(clouds, { ...camera, near: this.manifest.near, border });
    sorted.then(
      (sorted) => {
        this.order = { ...sorted, frame, camera };
        this.isDirty = true;
      },
      (error) => this.failed(error),
    );
  }

  /** Whether the depth order is that of the current frame and view. */
  #isSorted() {
    if (!this.order || this.order.frame !== this.clock.frame || !this.renderer) return false;
    const sorted = signature(this.order.camera);
    return signature(this.camera(1)).every((value, index) => value === sorted[index]);
  }

  /**
   * @param {number} frame
   * @returns {(import("../draw/frame_textures.js").Cloud | null)[]}
   */
  #clouds(frame) {
    return [this.store.get(frame), this.store.get(BACKGROUND)].map((entry) =>
      entry?.base ? { base: entry.base, views: entry.views } : null,
    );
  }

  /** @param {object} base */
  #numberOf(base) {
    if (!this.cloudNumbers.has(base)) this.cloudNumbers.set(base, this.cloudCount++);
    return this.cloudNumbers.get(base);
  }

  /**
   * @param {Camera} camera
   * @param {{views: number[], weights: number[]}} selection
   */
  #draw(camera, selection) {
    const { order, renderer } = this;
    if (!order || !renderer || !this.store.isDrawable(order.frame)) return;
    const picture = {
      clouds: this.#clouds(order.frame),
      shadow: this.store.get(order.frame)?.shadow ?? null,
      order,
      camera,
      selection,
      layers: this.layers,
      background: this.background,
    };
    renderer.draw(picture, this.mode);
  }
}

/**
 * The numbers that determine the depth order and the visible points, independent of the resolution.
 * @param {Camera} camera
 */
function signature({ rotation, translation, intrinsics, width, height }) {
  return [...rotation, ...translation, (intrinsics[4] / height).toFixed(3), (width / height).toFixed(2)];
}
