import {
  addScaled, apply, cross, dot, length, multiply, normalize, orthonormalize, rotationAbout, row, transpose,
} from "./math.js";
/** @typedef {import("../scene/manifest.js").Camera} Camera */

/**
 * A viewpoint: an eye, and a pivot on the eye's viewing axis. The fields are those of the class Pose in
 * viewer/navigation/pose.py.
 * @typedef {object} Pose
 * @property {number[]} pivot Point (3,) that the eye orbits around, in world units.
 * @property {number[]} rotation 3 x 3, R_camera_world.
 * @property {number} distance From the eye to the pivot, above 0.
 * @property {number} fieldOfView Vertical field of view in radians.
 * @property {number[]} up Up direction of the world, a unit vector.
 * @property {number[]} offset Offset (x, y) of the principal point from the image centre, in image heights.
 */

const MIN_POLE_ANGLE = Math.PI / 180;
const MIN_DISTANCE = 1e-3;
const MAX_DISTANCE = 1e6;

/**
 * @param {Pose} pose
 * @returns {number[]}
 */
export function eyeOf(pose) {
  return addScaled(pose.pivot, -pose.distance, row(pose.rotation, 2));
}

/**
 * Returns the camera of a pose for an image of `width` x `height` pixels.
 * @param {Pose} pose
 * @param {number} width
 * @param {number} height
 * @returns {Camera}
 */
export function cameraOf(pose, width, height) {
  const focal = height / 2 / Math.tan(pose.fieldOfView / 2);
  const [x, y] = pose.offset;
  const intrinsics = [focal, 0, width / 2 + x * height, 0, focal, height / 2 + y * height, 0, 0, 1];
  const translation = apply(pose.rotation, eyeOf(pose)).map((value) => -value);
  return { intrinsics, rotation: pose.rotation, translation, width, height };
}

/**
 * Rotates the eye about the pivot, as if the user dragged the scene to the right by `right` and down by `down`, both in
 * radians. The rotation stops 1 degree before the viewing axis is parallel to the up direction.
 * @param {Pose} pose
 * @param {number} right
 * @param {number} down
 * @returns {Pose}
 */
export function orbit(pose, right, down) {
  const forward = row(pose.rotation, 2);
  const crossed = cross(forward, pose.up);
  const level = length(crossed) > 1e-6 ? normalize(crossed) : row(pose.rotation, 0);
  const sign = dot(level, row(pose.rotation, 0)) < 0 ? -1 : 1;
  const angle = Math.acos(clamp(dot(forward, pose.up), -1, 1));
  const low = Math.min(angle, MIN_POLE_ANGLE);
  const high = Math.max(angle, Math.PI - MIN_POLE_ANGLE);
  const tilt = clamp(angle + sign * down, low, high) - angle;
  const turn = multiply(rotationAbout(pose.up, -sign * right), rotationAbout(level, -tilt));
  return { ...pose, rotation: orthonormalize(multiply(pose.rotation, transpose(turn))) };
}

/**
 * Translates the eye and the pivot, as if the user dragged the scene at the depth of the pivot. `right` and `down` are
 * the lengths of the drag, as fractions of the image height.
 * @param {Pose} pose
 * @param {number} right
 * @param {number} down
 * @returns {Pose}
 */
export function pan(pose, right, down) {
  const scale = -2 * Math.tan(pose.fieldOfView / 2) * pose.distance;
  const moved = addScaled(pose.pivot, scale * right, row(pose.rotation, 0));
  return { ...pose, pivot: addScaled(moved, scale * down, row(pose.rotation, 1)) };
}

/**
 * Multiplies the distance from the eye to the pivot by `factor`.
 * @param {Pose} pose
 * @param {number} factor
 * @returns {Pose}
 */
export function dolly(pose, factor) {
  return { ...pose, distance: clamp(pose.distance * factor, MIN_DISTANCE, MAX_DISTANCE) };
}

/**
 * Translates the eye and the pivot along the eye's axes, by lengths in world units.
 * @param {Pose} pose
 * @param {number} right
 * @param {number} up
 * @param {number} forward
 * @returns {Pose}
 */
export function fly(pose, right, up, forward) {
  let pivot = addScaled(pose.pivot, right, row(pose.rotation, 0));
  pivot = addScaled(pivot, -up, row(pose.rotation, 1));
  return { ...pose, pivot: addScaled(pivot, forward, row(pose.rotation, 2)) };
}

/**
 * Returns the pose whose image of `width` x `height` pixels contains the whole image of a camera.
 * @param {Camera} camera
 * @param {number[]} focus Point near which the pivot is placed.
 * @param {number[]} up
 * @param {number} width
 * @param {number} height
 * @returns {Pose}
 */
export function poseFromCamera(camera, focus, up, width, height) {
  const zoom = Math.min(width / camera.width, height / camera.height);
  // A pose has a single focal length, because its pixels are square. The shorter of the camera's two focal lengths
  // avoids cropping.
  const focal = zoom * Math.min(camera.intrinsics[0], camera.intrinsics[4]);
  const centre = apply(transpose(camera.rotation), camera.translation).map((value) => -value);
  const forward = row(camera.rotation, 2);
  const along = dot(addScaled(focus, -1, centre), forward);
  const distance = along > MIN_DISTANCE ? along : 1;
  return {
    pivot: addScaled(centre, distance, forward),
    rotation: camera.rotation,
    distance,
    fieldOfView: 2 * Math.atan2(height / 2, focal),
    up,
    offset: [
      (zoom * (camera.intrinsics[2] - camera.width / 2)) / height,
      (zoom * (camera.intrinsics[5] - camera.height / 2)) / height,
    ],
  };
}

/**
 * Returns the mean of the cameras' up directions, or the first camera's up direction if they cancel out.
 * @param {Camera[]} cameras At least one.
 * @returns {number[]}
 */
export function estimateUp(cameras) {
  let sum = [0, 0, 0];
  for (const camera of cameras) sum = addScaled(sum, -1 / cameras.length, row(camera.rotation, 1));
  return length(sum) < 1e-3 ? row(cameras[0].rotation, 1).map((value) => -value) : normalize(sum);
}

/**
 * @param {number} value
 * @param {number} low
 * @param {number} high
 */
function clamp(value, low, high) {
  return Math.min(Math.max(value, low), high);
}
