import { selectSourceViews } from "../navigate/source_views.js";
import { Sorter } from "../sort/sorter.js";
import { backgroundFirst } from "../draw/frame_textures.js";
import { BACKGROUND } from "../scene/members.js";
import { LONGEST_WAIT, adaptStride, planStart } from "./buffering.js";
import { Clock } from "./clock.js";
import { FrameStore } from "./frame_store.js";
import { Sound } from "./sound.js";
/** @typedef {import("../scene/manifest.js").Camera} Camera */
/** @typedef {import("../draw/projected_points.js").Picture} Picture */

/** Playback starts when the current frame and this number of following frames are decoded. */
const BUFFERED_FRAMES = 3;
/** Limits, in bytes, of the memory for decoded and for compressed frames that follow the current frame. */
const DECODED_BYTES = 96 << 20;
const DOWNLOADED_BYTES = 64 << 20;
const MAX_DECODED = 24;
const PAUSED_AHEAD = 2;
/** Maximum number of frames that are taken into account when playback is planned. */
const MAX_PLANNED = 3000;
/** Minimum time in seconds between two changes of the stride during playback. */
const ADAPT_SECONDS = 0.5;

/** Loads the frames that are due and sorts their points for a camera. Drawing them is left to the caller. */
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
    /** The sound of the scene, or null if it has none. */
    this.sound = this.manifest.sound ? new Sound(file, this.manifest.sound, this.clock) : null;
    /** Whether the frame that is due cannot be shown yet. */
    this.isWaiting = true;
    /** Whether playback is waiting for enough frames to continue without a pause. */
    this.isBuffering = true;
    /** Seconds since playback began to wait. */
    this.waited = 0;
    this.sinceAdapted = 0;
    /** Whether normals are loaded with the frames. Styles need normals. */
    this.needsNormals = false;
    /** The newest depth order. @type {(import("../sort/sorter.js").SortedPoints & {frame: number, camera: Camera}) | null} */
    this.order = null;
    this.cloudNumbers = new WeakMap();
    this.cloudCount = 0;
    const decoded = Math.max(this.manifest.mostPoints, 1) * (18 + 2 * this.manifest.dynamicEncoding.shRows);
    this.decodedAhead = Math.min(Math.max(Math.floor(DECODED_BYTES / decoded), 4), MAX_DECODED);
    this.downloadedAhead = Math.max(Math.floor(DOWNLOADED_BYTES / meanBytes(file)), this.decodedAhead);
  }

  /**
   * Advances the time, requests frames, and starts to sort the points if a new depth order is needed.
   * @param {number} elapsed Seconds since the last call.
   * @param {Camera} camera
   */
  update(elapsed, camera) {
    this.#advance(elapsed);
    this.sound?.follow(this.clock.isPlaying && !this.isBuffering);
    const { views } = selectSourceViews(camera, this.manifest);
    const { clock } = this;
    const { frame, isPlaying } = clock;
    const next = [frame, ...clock.upcoming(isPlaying ? this.downloadedAhead : PAUSED_AHEAD)];
    const decoded = next.slice(0, 1 + (isPlaying ? this.decodedAhead : PAUSED_AHEAD));
    const isSkipping = isPlaying && clock.stride > 1;
    const skipped = isSkipping ? clock.upcoming(this.downloadedAhead, 1).filter((other) => other % clock.stride) : [];
    const { needsNormals: normals } = this;
    this.store.want({ decoded, downloaded: [...next, ...skipped], views, normals, isPlaying });
    this.#sort(frame, camera);
  }

  /**
   * Returns true if the depth order was computed for the current frame and the given camera, and all source views are
   * loaded.
   * @param {Camera} camera
   */
  isSettled(camera) {
    return this.isSorted(camera) && !this.sorter.isBusy && this.store.isComplete(this.clock.frame);
  }

  /**
   * Returns true if the depth order was computed for the current frame and the given camera.
   * @param {Camera} camera
   */
  isSorted(camera) {
    if (!this.order || this.order.frame !== this.clock.frame) return false;
    const sorted = signature(this.order.camera);
    return signature(camera).every((value, index) => value === sorted[index]);
  }

  /**
   * Returns what to draw from a camera, with the frame of the newest depth order, or null if nothing can be drawn.
   * @param {Camera} camera
   * @param {{views: number[], weights: number[]}} selection
   * @returns {Picture | null}
   */
  picture(camera, selection) {
    const { order, manifest } = this;
    if (!order || !this.store.hasPoints(order.frame)) return null;
    this.sound?.shown(order.frame);
    const shadow = this.store.get(order.frame)?.shadow ?? null;
    return { clouds: this.#clouds(order.frame), shadow, order, camera, selection, layers: manifest.layers };
  }

  release() {
    this.sound?.release();
    this.sorter.release();
    this.store.release();
  }

  /** @param {number} elapsed */
  #advance(elapsed) {
    const { clock, store } = this;
    if (!clock.isPlaying || this.isBuffering) {
      this.waited = clock.isPlaying ? this.waited + elapsed : 0;
      this.isBuffering = !clock.isPlaying || !this.#canStart();
      this.isWaiting = clock.isPlaying ? this.isBuffering : !store.isComplete(clock.frame);
      if (this.isBuffering) return;
    }
    const { seconds } = clock;
    clock.advance(Math.min(elapsed, 0.25));
    this.isWaiting = !store.isComplete(clock.frame);
    if (this.isWaiting) {
      clock.seconds = seconds;
      this.isBuffering = true;
      this.waited = 0;
    }
    this.sinceAdapted += elapsed;
    if (this.sinceAdapted < ADAPT_SECONDS) return;
    this.sinceAdapted = 0;
    const buffer = this.#buffer();
    if (buffer) clock.stride = adaptStride(buffer, clock.stride);
  }

  /** Chooses the stride. Returns true if playback can start. */
  #canStart() {
    const { clock, store } = this;
    const buffer = this.#buffer();
    if (!buffer) return false;
    const plan = planStart(buffer, Math.max(LONGEST_WAIT - this.waited, 0));
    clock.stride = plan.stride;
    const isDecoded = [clock.frame, ...clock.upcoming(BUFFERED_FRAMES)].every((frame) => store.isComplete(frame));
    return isDecoded && (plan.wait === 0 || this.waited >= LONGEST_WAIT);
  }

  /**
   * Returns the frames from the current frame to the end of the scene, or all frames if playback loops. The result is
   * null if the data rate of the connection is not known.
   * @returns {import("./buffering.js").Buffer | null}
   */
  #buffer() {
    const { clock, store } = this;
    const frames = [clock.frame, ...clock.upcoming(MAX_PLANNED, 1)];
    const missing = frames.map((frame) => store.missingBytes(frame));
    const rate = store.file.source.rate.bytesPerSecond;
    return rate === null ? null : { frames, missing, interval: 1 / (clock.fps * clock.speed), rate };
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
      entry?.base ? { base: entry.base, views: entry.views, normals: entry.normals } : null,
    );
  }

  /** @param {object} base */
  #numberOf(base) {
    if (!this.cloudNumbers.has(base)) this.cloudNumbers.set(base, this.cloudCount++);
    return this.cloudNumbers.get(base);
  }
}

/**
 * Returns the camera parameters that determine the depth order and the visible points. They do not depend on the
 * resolution of the image.
 * @param {Camera} camera
 */
function signature({ rotation, translation, intrinsics, width, height }) {
  return [...rotation, ...translation, (intrinsics[4] / height).toFixed(3), (width / height).toFixed(2)];
}

/**
 * Returns the mean number of compressed bytes that a player downloads per frame.
 * @param {import("../scene/scene_file.js").SceneFile} file
 */
function meanBytes({ manifest }) {
  const { sources, neighbours } = manifest;
  let bytes = 0;
  for (const [name, [, size]] of manifest.members) {
    if (!name.startsWith("frames/") || name.includes("/optional/")) continue;
    bytes += name.includes("/views/") ? (size * Math.min(neighbours, sources.length)) / sources.length : size;
  }
  return Math.max(bytes / manifest.points.length, 1);
}
