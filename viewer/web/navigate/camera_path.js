import { length, row, toQuaternion, addScaled } from "./math.js";
import { monotoneCubic, naturalSpline } from "./splines.js";
import { smoothTurns } from "./turns.js";
import { eyeOf } from "./pose.js";
/** @typedef {import("./pose.js").Pose} Pose */

/** A pose through which a path leads, the time on the path in seconds, and the scene's frame at this time.
 * @typedef {{pose: Pose, seconds: number, frame: number}} KeyFrame */

/** Seconds between two key frames. */
export const STEP_SECONDS = 2;
const AT_REST = 1e-7;
const FPS = 30;

/**
 * A camera path through key frames. It is the path of viewer/camera_paths/motion.py with smooth key frames.
 */
export class CameraPath {
  constructor() {
    /** @type {KeyFrame[]} */
    this.keys = [];
    /** @type {{start: number, at: (seconds: number) => Pose}[] | null} */
    this.runs = null;
  }

  /** Duration in seconds. */
  get duration() {
    return this.keys.length === 0 ? 0 : this.keys[this.keys.length - 1].seconds;
  }

  /**
   * Adds a view to the end of the path.
   * @param {Pose} pose
   * @param {number} frame
   */
  add(pose, frame) {
    const seconds = this.keys.length === 0 ? 0 : this.duration + STEP_SECONDS;
    this.keys.push({ pose, seconds, frame });
    this.runs = null;
  }

  /**
   * Returns the view and the frame at a time in seconds. The path must have a key frame.
   * @param {number} seconds
   * @returns {{pose: Pose, frame: number}}
   */
  at(seconds) {
    this.runs ??= makeRuns(this.keys);
    const run = this.runs.filter((each) => each.start <= seconds).pop() ?? this.runs[0];
    const times = this.keys.map((key) => key.seconds);
    const frame = monotoneCubic(times, this.keys.map((key) => key.frame))(seconds);
    return { pose: run.at(seconds), frame: Math.round(frame) };
  }

  /** Returns the content of a file that `fourd render --path` reads. */
  toJson() {
    const keys = this.keys.map(({ pose, seconds, frame }) => ({
      seconds, frame, easing: "smooth", pivot: pose.pivot, rotation: [0, 1, 2].map((index) => row(pose.rotation, index)),
      distance: pose.distance, field_of_view: pose.fieldOfView, up: pose.up, offset: pose.offset,
    }));
    return { format: "fourd-path", version: 2, fps: FPS, loop_seconds: null, keys };
  }
}

/**
 * Splits the path where the camera rests between two equal key frames.
 * @param {KeyFrame[]} keys
 */
function makeRuns(keys) {
  const vectors = keys.map((key) => toVector(key.pose));
  const unit = Math.max(keys.reduce((sum, key) => sum + key.pose.distance, 0) / keys.length, 1e-9);
  const steps = vectors.slice(1).map((vector, i) => distance(vectors[i], vector, unit));
  const runs = [];
  for (let first = 0; first < keys.length; ) {
    let last = first;
    while (last + 1 < keys.length && steps[last] > AT_REST) last++;
    runs.push(makeRun(keys.slice(first, last + 1), vectors.slice(first, last + 1), steps.slice(first, last)));
    first = last + 1;
  }
  return runs;
}

/**
 * @param {KeyFrame[]} keys
 * @param {number[][]} vectors
 * @param {number[]} steps Distances between successive key frames.
 */
function makeRun(keys, vectors, steps) {
  const start = keys[0].seconds;
  if (keys.length === 1) return { start, at: () => keys[0].pose };
  const times = keys.map((key) => key.seconds);
  const s = [0];
  for (const step of steps) s.push(s[s.length - 1] + Math.sqrt(step));
  const progress = monotoneCubic(times, s);
  const curve = naturalSpline(s, vectors.map((vector) => vector.slice(0, 7)));
  const turns = smoothTurns(s, keys.map((key) => key.pose.rotation));
  const at = (/** @type {number} */ seconds) => {
    const key = keys.find((each) => each.seconds === seconds);
    if (key) return key.pose;
    const index = Math.max(times.filter((time) => time <= seconds).length - 1, 0);
    const along = progress(seconds);
    return fromVector(curve(along), turns(along), keys[index].pose.up);
  };
  return { start, at };
}

/**
 * Converts a pose to eye, logarithms of distance and zoom, offset, and quaternion.
 * @param {Pose} pose
 */
function toVector(pose) {
  const zoom = Math.log(Math.tan(pose.fieldOfView / 2));
  return [...eyeOf(pose), Math.log(pose.distance), zoom, ...pose.offset, ...toQuaternion(pose.rotation)];
}

/**
 * @param {number[]} vector
 * @param {number[]} rotation
 * @param {number[]} up
 * @returns {Pose}
 */
function fromVector(vector, rotation, up) {
  const distance = Math.exp(vector[3]);
  const pivot = addScaled(vector.slice(0, 3), distance, row(rotation, 2));
  return { pivot, rotation, distance, fieldOfView: 2 * Math.atan(Math.exp(vector[4])), up, offset: vector.slice(5, 7) };
}

/**
 * Returns the distance of two poses without unit, as `_steps` in viewer/camera_paths/motion.py.
 * @param {number[]} a
 * @param {number[]} b
 * @param {number} unit
 */
function distance(a, b, unit) {
  const moved = length([0, 1, 2].map((k) => (b[k] - a[k]) / unit));
  let cosine = 0;
  for (let k = 7; k < 11; k++) cosine += a[k] * b[k];
  const turned = 2 * Math.acos(Math.min(Math.abs(cosine), 1));
  return Math.hypot(moved, b[4] - a[4], b[5] - a[5], b[6] - a[6], turned < 1e-7 ? 0 : turned);
}
