import { addScaled, apply, cross, dot, length, normalize } from "./math.js";

/**
 * Returns the matrix that places a scene upright in a world whose y axis points up, as in three.js and WebXR.
 * @param {number[]} origin Point in the scene that is mapped to `target`.
 * @param {number[]} up Up direction of the scene, a unit vector that is mapped to +y.
 * @param {number[]} forward Direction in the scene whose horizontal part is mapped to -z.
 * @param {number} scale Length of one unit of the scene, in units of the world.
 * @param {number[]} [target] Point (3,) in the world.
 * @returns {number[]} (16,) column-major.
 */
export function uprightMatrix(origin, up, forward, scale, target = [0, 0, 0]) {
  const level = addScaled(forward, -dot(forward, up), up);
  const ahead = normalize(length(level) > 1e-3 ? level : perpendicularTo(up));
  const right = cross(ahead, up);
  const rows = [...right, ...up, ...ahead.map((value) => -value)].map((value) => scale * value);
  const [x, y, z] = addScaled(target, -1, apply(rows, origin));
  return [rows[0], rows[3], rows[6], 0, rows[1], rows[4], rows[7], 0, rows[2], rows[5], rows[8], 0, x, y, z, 1];
}

/** @param {number[]} v A unit vector. */
function perpendicularTo(v) {
  return cross(v, Math.abs(v[0]) < 0.6 ? [1, 0, 0] : [0, 1, 0]);
}
