import { SceneError } from "../scene/errors.js";
import { cross, dot, length } from "./math.js";
/** @typedef {import("../scene/manifest.js").Camera} Camera */

/** A 3 x 3 matrix counts as a rotation with uniform scale if its columns are equally long and perpendicular, up to this
 * relative error. */
const TOLERANCE = 1e-3;

/**
 * Converts OpenGL matrices, as in three.js and WebXR, to a camera and a mapping from depths to normalised device
 * coordinates.
 * @param {ArrayLike<number>} modelView (16,) column-major. It maps the scene's world to OpenGL's camera coordinates, by
 *   a rotation, a translation and a uniform scale.
 * @param {ArrayLike<number>} projection (16,) column-major. A perspective projection that maps depths to the range from
 *   -1 to 1.
 * @param {number} width Width of the viewport in pixels.
 * @param {number} height
 * @returns {{camera: Camera, depthRange: [number, number]}} The camera, and numbers a and b, with which a point at
 *   depth z, in the scene's units, has the depth a + b / z in normalised device coordinates.
 */
export function hostCamera(modelView, projection, width, height) {
  const m = modelView;
  const p = projection;
  if (!isFinite16(m)) throw new SceneError("modelView: expected 16 finite numbers, got others; check the matrices");
  if (!isFinite16(p) || p[11] !== -1 || p[15] !== 0 || !(p[0] > 0 && p[5] > 0)) {
    throw new SceneError("projection: expected a perspective projection of OpenGL, got another matrix; check the camera");
  }
  const columns = [0, 4, 8].map((first) => [m[first], m[first + 1], m[first + 2]]);
  const scale = length(columns[0]);
  const slack = TOLERANCE * scale;
  const volume = dot(cross(columns[0], columns[1]), columns[2]);
  const isSimilar =
    scale > 0 && volume > 0 && columns.every((axis) => Math.abs(length(axis) - scale) < slack) &&
    [[0, 1], [0, 2], [1, 2]].every(([i, j]) => Math.abs(dot(columns[i], columns[j])) < slack * scale);
  if (!isSimilar) {
    const expected = "expected a rotation, a translation and a uniform scale";
    throw new SceneError(`modelView: ${expected}, got another transformation; change the scene's matrix`);
  }
  // The y and z axes of OpenGL cameras are opposite to those of the scene's cameras.
  const rotation = [0, 1, 2].flatMap((row) => columns.map((axis) => ((row ? -1 : 1) * axis[row]) / scale));
  const translation = [m[12] / scale, -m[13] / scale, -m[14] / scale];
  const [halfWidth, halfHeight] = [width / 2, height / 2];
  const intrinsics = [
    p[0] * halfWidth, -p[4] * halfWidth, (1 - p[8]) * halfWidth,
    0, p[5] * halfHeight, (1 + p[9]) * halfHeight,
    0, 0, 1,
  ];
  return { camera: { intrinsics, rotation, translation, width, height }, depthRange: [-p[10], p[14] / scale] };
}

/**
 * Returns the product of two OpenGL matrices.
 * @param {ArrayLike<number>} a (16,) column-major.
 * @param {ArrayLike<number>} b
 * @returns {number[]}
 */
export function multiply4(a, b) {
  return Array.from({ length: 16 }, (_, index) => {
    const [row, column] = [index % 4, 4 * Math.floor(index / 4)];
    return a[row] * b[column] + a[row + 4] * b[column + 1] + a[row + 8] * b[column + 2] + a[row + 12] * b[column + 3];
  });
}

/** @param {ArrayLike<number>} matrix */
function isFinite16(matrix) {
  return matrix.length === 16 && Array.from(matrix).every(Number.isFinite);
}
