import { addScaled, apply, cross, dot, length, normalize, transpose } from "./math.js";
/** @typedef {import("../scene/manifest.js").Camera} Camera */
/** @typedef {import("../scene/manifest.js").Manifest} Manifest */

/** If all source views are selected, the limit angle b of `fadingWeights` is the largest of their angles times this
 * factor. */
const FADE_MARGIN = 1.25;

/**
 * Returns the source views with the smallest angles to a camera, and their view weights. Angles are measured at the
 * focus. The rules are the same as in fourd/base/cameras.py.
 * @param {Camera} camera
 * @param {Manifest} manifest
 * @returns {{views: number[], weights: number[]}}
 */
export function selectSourceViews(camera, manifest) {
  const direction = rayFrom(manifest.focus, camera);
  const rays = manifest.sources.map((source) => rayFrom(manifest.focus, source));
  const cosines = rays.map((ray) => dot(ray, direction));
  const nearest = cosines.map((_, index) => index).sort((a, b) => cosines[b] - cosines[a] || a - b);
  const views = nearest.slice(0, manifest.neighbours);
  if (!manifest.fadeViews) return { views, weights: views.map(() => 1) };
  const angles = rays.map((ray, index) => Math.atan2(length(cross(ray, direction)), cosines[index]));
  return { views, weights: fadingWeights(views, angles) };
}

/**
 * Returns weights that decrease with the angle, so that a view fades out before it drops out of the selection. A view
 * at the angle a has the weight 1 - a / b, where the limit b is the angle of the first view that is not selected. If
 * all weights would be 0, they are 1 instead.
 * @param {number[]} views
 * @param {number[]} angles
 */
function fadingWeights(views, angles) {
  const largest = Math.max(...views.map((view) => angles[view]));
  const beyond = angles.filter((angle, view) => !views.includes(view) && angle >= largest);
  const limit = beyond.length ? Math.min(...beyond) : FADE_MARGIN * largest;
  const weights = views.map((view) => 1 - angles[view] / Math.max(limit, 1e-9));
  return Math.max(...weights) > 0 ? weights : views.map(() => 1);
}

/**
 * @param {number[]} focus
 * @param {Camera} camera
 */
function rayFrom(focus, camera) {
  const centre = apply(transpose(camera.rotation), camera.translation).map((value) => -value);
  return normalize(addScaled(centre, -1, focus));
}
