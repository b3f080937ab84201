/** Functions on vectors (3,) and 3 x 3 matrices, which are flat lists in row-major order. */

/** @typedef {number[]} Vector */
/** @typedef {number[]} Matrix */

/**
 * @param {Vector} a
 * @param {Vector} b
 * @returns {number}
 */
export function dot(a, b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/**
 * @param {Vector} a
 * @param {Vector} b
 * @returns {Vector}
 */
export function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

/** @param {Vector} a */
export function length(a) {
  return Math.hypot(a[0], a[1], a[2]);
}

/**
 * Returns `a + scale * b`.
 * @param {Vector} a
 * @param {number} scale
 * @param {Vector} b
 * @returns {Vector}
 */
export function addScaled(a, scale, b) {
  return [a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]];
}

/**
 * @param {Vector} a
 * @returns {Vector}
 */
export function normalize(a) {
  const scale = 1 / Math.max(length(a), 1e-12);
  return [a[0] * scale, a[1] * scale, a[2] * scale];
}

/**
 * @param {Matrix} m
 * @param {number} index
 * @returns {Vector}
 */
export function row(m, index) {
  return m.slice(3 * index, 3 * index + 3);
}

/**
 * @param {Matrix} m
 * @param {Vector} v
 * @returns {Vector}
 */
export function apply(m, v) {
  return [dot(row(m, 0), v), dot(row(m, 1), v), dot(row(m, 2), v)];
}

/**
 * @param {Matrix} m
 * @returns {Matrix}
 */
export function transpose(m) {
  return [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]];
}

/**
 * @param {Matrix} a
 * @param {Matrix} b
 * @returns {Matrix}
 */
export function multiply(a, b) {
  const columns = transpose(b);
  return [0, 1, 2].flatMap((i) => [0, 1, 2].map((j) => dot(row(a, i), row(columns, j))));
}

/**
 * Returns the rotation about a unit axis by an angle in radians (Rodrigues' formula).
 * @param {Vector} axis
 * @param {number} angle
 * @returns {Matrix}
 */
export function rotationAbout([x, y, z], angle) {
  const c = Math.cos(angle);
  const s = Math.sin(angle);
  const t = 1 - c;
  return [
    c + t * x * x, t * x * y - s * z, t * x * z + s * y,
    t * x * y + s * z, c + t * y * y, t * y * z - s * x,
    t * x * z - s * y, t * y * z + s * x, c + t * z * z,
  ];
}

/**
 * Removes rounding errors from a rotation matrix. The direction of the last row does not change.
 * @param {Matrix} m
 * @returns {Matrix}
 */
export function orthonormalize(m) {
  const z = normalize(row(m, 2));
  const x = normalize(cross(row(m, 1), z));
  return [...x, ...cross(z, x), ...z];
}

/**
 * Returns the unit quaternion (w, x, y, z) of a rotation matrix, with w >= 0.
 * @param {Matrix} m
 * @returns {number[]}
 */
export function toQuaternion(m) {
  const trace = m[0] + m[4] + m[8];
  const squares = [1 + trace, 1 + 2 * m[0] - trace, 1 + 2 * m[4] - trace, 1 + 2 * m[8] - trace];
  const rows = [
    [squares[0], m[7] - m[5], m[2] - m[6], m[3] - m[1]],
    [m[7] - m[5], squares[1], m[1] + m[3], m[2] + m[6]],
    [m[2] - m[6], m[1] + m[3], squares[2], m[5] + m[7]],
    [m[3] - m[1], m[2] + m[6], m[5] + m[7], squares[3]],
  ];
  const largest = rows[squares.indexOf(Math.max(...squares))];
  const scale = (largest[0] < 0 ? -1 : 1) / Math.hypot(...largest);
  return largest.map((value) => value * scale);
}

/**
 * @param {number[]} quaternion (w, x, y, z) of any length above 0.
 * @returns {Matrix}
 */
export function fromQuaternion(quaternion) {
  const scale = 1 / Math.hypot(...quaternion);
  const [w, x, y, z] = quaternion.map((value) => value * scale);
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
    2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
  ];
}
