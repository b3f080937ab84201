import { apply, length } from "../navigate/math.js";
/** @typedef {import("./style_file.js").Style} Style */
/** @typedef {import("../scene/manifest.js").Camera} Camera */

/** Lengths in a style are in pixels of an image with this number of rows. */
const REFERENCE_ROWS = 1080;
const MAX_THICKNESS = 8;
const LEAST_SPACING = 3;

/**
 * Returns the uniforms of viewer/web/shaders/stylize/picture.frag.js for a camera, as `view_style` of fourd/scene/styles/view.py
 * does.
 * @param {Style} style
 * @param {Camera} camera
 * @param {number[]} focus Centre of the scene.
 * @param {[number, number, number]} background Colour in [0, 1], used if the style has no paper.
 * @returns {{floats: Record<string, number | number[]>, integers: Record<string, number>}}
 */
export function viewStyle(style, camera, focus, background) {
  const scale = camera.height / REFERENCE_ROWS;
  const thickness = Math.floor(style.thickness * scale + 0.5);
  const floats = {
    ...style.numbers,
    ray: rayOf(camera),
    light: style.light_frame === "world" ? apply(camera.rotation, style.light) : style.light,
    detail_per_depth: style.detail_per_distance / distanceTo(camera, focus),
    hatch_spacing: Math.max(style.hatch_spacing * scale, LEAST_SPACING),
    paper: style.paper ?? background,
  };
  const integers = {
    detail_axis: style.detail_axis,
    line_filter: style.line_filter,
    thickness: Math.min(Math.max(thickness, 1), MAX_THICKNESS),
  };
  return { floats, integers };
}

/**
 * Returns the distance from a camera to a point in world units, but at least 1e-6.
 * @param {Camera} camera
 * @param {number[]} point
 */
export function distanceTo({ rotation, translation }, point) {
  const [x, y, z] = apply(rotation, point);
  return Math.max(length([x + translation[0], y + translation[1], z + translation[2]]), 1e-6);
}

/**
 * Returns the first two rows of the inverse intrinsic matrix. The third row is (0, 0, 1).
 * @param {Camera} camera
 */
function rayOf({ intrinsics }) {
  const [fx, skew, cx, shear, fy, cy] = intrinsics;
  const det = fx * fy - skew * shear;
  return [fy / det, -skew / det, (skew * cy - cx * fy) / det, -shear / det, fx / det, (shear * cx - fx * cy) / det];
}
