import { selectSourceViews } from "../navigate/source_views.js";
import { Sorter } from "../sort/sorter.js";
import { backgroundFirst } from "../draw/frame_textures.js";
import { Clock } from "./clock.js";
import { BACKGROUND, FrameStore } from "./frame_store.js";
/** @typedef {import("../scene/manifest.js").Camera} Camera */
/** @typedef {import("../draw/projected_points.js").Picture} Picture */

const BUFFERED_FRAMES = 3;
const AHEAD_BYTES = 96 << 20;
const MAX_AHEAD = 24;

/** Loads the frames that are due and sorts their points for a camera. Draws nothing. */
export class Playback {
  /**
   * @param {import("../scene/scene_file.js").SceneFile} file
   * @param {import("../decode/pool.js").DecodePool} pool
   * @param {() => void} changed Called when new points, colours or a new depth order can be drawn.
   * @param {(error: unknown) => void} failed
   */
  constructor(file, pool, changed, failed) {
    this.manifest = file.manifest;
    this.changed = changed;
    this.failed = failed;
    this.store = new FrameStore(file, pool, changed, failed);
    this.sorter = new Sorter();
    this.clock = new Clock(this.manifest.points.length, this.manifest.fps);
    this.isWaiting = true;
    /** The newest depth order. @type {(import("../sort/sorter.js").SortedPoints & {frame: number, camera: Camera}) | null} */
    this.order = null;
    this.cloudNumbers = new WeakMap();
    this.cloudCount = 0;
    const fetched = Math.max(this.manifest.mostPoints, 1) * (18 + 2 * this.manifest.dynamicEncoding.shRows);
    this.ahead = Math.min(Math.max(Math.floor(AHEAD_BYTES / fetched), 4), MAX_AHEAD);
  }

  /**
   * Advances the time, requests frames and starts to sort if needed.
   * @param {number} elapsed Seconds since the last call.
   * @param {Camera} camera
   */
  update(elapsed, camera) {
    this.#advance(elapsed);
    const { views } = selectSourceViews(camera, this.manifest);
    const { frame, isPlaying } = this.clock;
    this.store.want([frame, ...this.clock.upcoming(isPlaying ? this.ahead : 2)], views);
    this.#sort(frame, camera);
  }

  /**
   * Whether the depth order is that of the current frame and of a camera, and all source views have arrived.
   * @param {Camera} camera
   */
  isSettled(camera) {
    return this.isSorted(camera) && !this.sorter.isBusy && this.store.isComplete(this.clock.frame);
  }

  /**
   * Whether the depth order is that of the current frame and of a camera.
   * @param {Camera} camera
   */
  isSorted(camera) {
    if (!this.order || this.order.frame !== this.clock.frame) return false;
    const sorted = signature(this.order.camera);
    return signature(camera).every((value, index) => value === sorted[index]);
  }

  /**
   * What an image from a camera shows. The frame is that of the newest depth order. Null if nothing can be drawn.
   * @param {Camera} camera
   * @param {{views: number[], weights: number[]}} selection
   * @returns {Picture | null}
   */
  picture(camera, selection) {
    const { order, manifest } = this;
    if (!order || !this.store.isDrawable(order.frame)) return null;
    const shadow = this.store.get(order.frame)?.shadow ?? null;
    return { clouds: this.#clouds(order.frame), shadow, order, camera, selection, layers: manifest.layers };
  }

  release() {
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
    if (this.sorter.isBusy || !this.store.isDrawable(frame) || this.isSorted(camera)) return;
    const clouds = this.#clouds(frame).flatMap((cloud, index) => {
      const first = index ? backgroundFirst(this.manifest) : 0;
      return cloud ? [{ cloud: this.#numberOf(cloud.base), first, radius: cloud.base.largestRadius, xyz: cloud.base.xyz }] : [];
    });
    const border = Math.max(camera.width, camera.height) / 2;
    const sorted = this.sorter.sort(clouds, { ...camera, near: this.manifest.near, border });
    sorted.then(
      (sorted) => {
        this.order = { ...sorted, frame, camera };
        this.changed();
      },
      (error) => this.failed(error),
    );
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
}

/**
 * The numbers that determine the depth order and the visible points, independent of the resolution.
 * @param {Camera} camera
 */
function signature({ rotation, translation, intrinsics, width, height }) {
  return [...rotation, ...translation, (intrinsics[4] / height).toFixed(3), (width / height).toFixed(2)];
}
