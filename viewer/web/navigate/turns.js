import { fromQuaternion, length, toQuaternion } from "./math.js";
/** @typedef {import("./math.js").Vector} Vector */

/**
 * Returns a smooth curve through rotations: cubic Bezier curves of quaternions, as in viewer/camera_paths/motion.py.
 * @param {number[]} s Increasing parameters of the rotations, at least 2.
 * @param {number[][]} rotations 3 x 3 each.
 * @returns {(at: number) => number[]} 3 x 3.
 */
export function smoothTurns(s, rotations) {
  const turns = rotations.map(toQuaternion);
  const steps = s.slice(1).map((value, i) => value - s[i]);
  const means = steps.map((step, i) => logarithm(multiply(turns[i + 1], inverse(turns[i]))).map((value) => value / step));
  const last = means.length - 1;
  const inner = means.slice(1).map((mean, i) => {
    return mean.map((value, k) => (steps[i + 1] * means[i][k] + steps[i] * value) / (steps[i] + steps[i + 1]));
  });
  const atEnd = (/** @type {Vector} */ mean, /** @type {Vector} */ next) => mean.map((value, k) => 1.5 * value - 0.5 * next[k]);
  const rates = last === 0 ? [means[0], means[0]]
    : [atEnd(means[0], inner[0]), ...inner, atEnd(means[last], inner[last - 1])];
  return (at) => {
    let i = 0;
    while (i < last && s[i + 1] <= at) i++;
    const third = steps[i] / 3;
    let points = [
      turns[i], multiply(exponential(rates[i].map((value) => third * value)), turns[i]),
      multiply(exponential(rates[i + 1].map((value) => -third * value)), turns[i + 1]), turns[i + 1],
    ];
    const share = (at - s[i]) / steps[i];
    while (points.length > 1) points = points.slice(1).map((end, k) => slerp(points[k], end, share));
    return fromQuaternion(points[0]);
  };
}

/**
 * @param {number[]} start
 * @param {number[]} end
 * @param {number} share
 */
function slerp(start, end, share) {
  const turn = logarithm(multiply(end, inverse(start)));
  return multiply(exponential(turn.map((value) => share * value)), start);
}

/**
 * Multiplies two quaternions (w, x, y, z).
 * @param {number[]} a
 * @param {number[]} b
 */
function multiply([aw, ax, ay, az], [bw, bx, by, bz]) {
  return [
    aw * bw - ax * bx - ay * by - az * bz, aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx, aw * bz + ax * by - ay * bx + az * bw,
  ];
}

/** @param {number[]} unit */
function inverse([w, x, y, z]) {
  return [w, -x, -y, -z];
}

/**
 * Returns the rotation vector of a unit quaternion, of at most half a turn.
 * @param {number[]} unit
 */
function logarithm([w, ...axis]) {
  const sine = length(axis);
  const scale = sine < 1e-12 ? 2 : (2 * Math.atan2(sine, Math.abs(w))) / sine;
  return axis.map((value) => (w < 0 ? -scale : scale) * value);
}

/** @param {Vector} turn */
function exponential(turn) {
  const angle = length(turn);
  const scale = angle < 1e-12 ? 0.5 : Math.sin(angle / 2) / angle;
  return [Math.cos(angle / 2), ...turn.map((value) => scale * value)];
}
