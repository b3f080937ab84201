import { fromQuaternion, toQuaternion } from "./math.js";
/** @typedef {import("./pose.js").Pose} Pose */

/**
 * Converts a pose and a time to the fragment of a link, such as `t=1.2&view=...`.
 * @param {Pose} pose
 * @param {number} seconds
 * @returns {string}
 */
export function toFragment(pose, seconds) {
  const numbers = [
    ...pose.pivot, ...toQuaternion(pose.rotation), pose.distance, pose.fieldOfView, ...pose.offset,
  ].map((value) => Number(value.toPrecision(7)));
  return `t=${Number(seconds.toFixed(3))}&view=${numbers.join(",")}`;
}

/**
 * Reads the pose and the time from a fragment that `toFragment` has written. Invalid values are ignored.
 * @param {string} fragment With or without a leading #.
 * @param {number[]} up
 * @returns {{pose?: Pose, seconds?: number}}
 */
export function fromFragment(fragment, up) {
  const parameters = new URLSearchParams(fragment.replace(/^#/, ""));
  const time = parameters.get("t");
  const seconds = time === null ? NaN : Number(time);
  const numbers = (parameters.get("view") ?? "").split(",").map(Number);
  /** @type {{pose?: Pose, seconds?: number}} */
  const found = {};
  if (Number.isFinite(seconds) && seconds >= 0) found.seconds = seconds;
  if (numbers.length === 11 && numbers.every((value) => Math.abs(value) < 1e9)) {
    const quaternion = numbers.slice(3, 7);
    const [distance, fieldOfView, x, y] = numbers.slice(7);
    if (Math.hypot(...quaternion) > 1e-3 && distance > 0 && fieldOfView > 1e-3 && fieldOfView < Math.PI) {
      const rotation = fromQuaternion(quaternion);
      found.pose = { pivot: numbers.slice(0, 3), rotation, distance, fieldOfView, up, offset: [x, y] };
    }
  }
  return found;
}
