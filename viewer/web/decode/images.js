import { SceneError } from "../scene/errors.js";
import { largestContent } from "../scene/limits.js";
import { missingDecoder } from "../scene/support.js";
import { damaged, inflate } from "./inflate.js";
/** @typedef {import("../scene/manifest.js").Camera} Camera */
/** @typedef {import("../scene/manifest.js").CloudEncoding} CloudEncoding */

/**
 * The decoded image of a source view. Plane 0 is Y. Planes 1 and 2 are Cb and Cr, with half the width and height.
 * @typedef {object} ViewImage
 * @property {number} left Column of the camera's texel grid at which the image starts.
 * @property {number} top
 * @property {Plane[]} planes
 */

/**
 * A plane of 8-bit values in `bytes`, whose first value is at index `offset`. `stride` is the number of bytes from one
 * row to the next, and `step` from one value to the next in a row.
 * @typedef {{bytes: Uint8Array, offset: number, stride: number, step: number, width: number, height: number}} Plane
 */

/** @typedef {{left: number, top: number, width: number, height: number, frame: Uint8Array}} StoredImage */

/** Size of the header in bytes. It contains the left column, top row, width and height of the image in texels (16 bits
 * each), and the size of the VP9 frame in bytes (32 bits). */
const HEADER = 12;
/** The texel value that encodes a colour difference of 0. */
const ZERO = 128;
/** The VP9 codec string: profile 0, level 5.1, 8 bits. */
const CODEC = "vp09.00.51.08";
const MAX_SIDE = 1 << 14;
const SMALLEST_FRAME = 1024;
const FRAME_BYTES_PER_TEXEL = 2;
const NEAR = 1e-6;
const RED_FROM_CR = 1.402;
const GREEN_FROM_CB = -0.344136;
const GREEN_FROM_CR = -0.714136;
const BLUE_FROM_CB = 1.772;

/**
 * Decodes the source views of a cloud whose colours are sampled from images, in the format that docs/formats.md
 * describes.
 * @param {{view: number, member: Uint8Array, camera: Camera}[]} views
 * @param {{xyz: Float32Array, mean: Uint8Array}} base Positions (N, 3) and mean colours (N, 4).
 * @param {number} scale Number of texels per camera pixel, along each axis.
 * @param {(view: number) => string} nameOf Names of the members, for error messages.
 * @returns {Promise<[number, Uint8Array<ArrayBuffer>][]>} For each view, (N, 4): red, green, blue, and the code of the
 *   blend weight.
 */
export async function decodeImageViews(views, base, scale, nameOf) {
  const points = base.mean.length / 4;
  const stored = await Promise.all(
    views.map(async ({ view, member, camera }) => {
      const name = nameOf(view);
      const largest = Math.min(points + largestImage(camera, scale), largestContent(member.length));
      const content = await inflate(member, largest, name);
      if (content.length < points + HEADER) throw damaged(name, `at least ${points + HEADER} bytes`, `${content.length}`);
      return { codes: content.subarray(0, points), image: parseImage(content.subarray(points), camera, scale, name) };
    }),
  );
  const images = await decodeFrames(stored.map(({ image }) => image), views.map(({ view }) => nameOf(view)));
  return views.map(({ view, camera }, index) => [view, addDifferences(stored[index].codes, images[index], base, camera, scale)]);
}

/**
 * @param {Camera} camera
 * @param {number} scale
 */
function gridSize({ width, height }, scale) {
  return [width, height].map((side) => Math.min(2 * Math.ceil((side * scale) / 2), MAX_SIDE));
}

/**
 * @param {Camera} camera
 * @param {number} scale
 */
function largestImage(camera, scale) {
  const [width, height] = gridSize(camera, scale);
  return HEADER + SMALLEST_FRAME + FRAME_BYTES_PER_TEXEL * width * height;
}

/**
 * Checks all sizes of an image before it is decoded.
 * @param {Uint8Array} content
 * @param {Camera} camera
 * @param {number} scale
 * @param {string} name
 * @returns {StoredImage}
 */
function parseImage(content, camera, scale, name) {
  const view = new DataView(content.buffer, content.byteOffset, content.byteLength);
  const [left, top, width, height] = [0, 2, 4, 6].map((at) => view.getUint16(at, true));
  const size = view.getUint32(8, true);
  if (content.length !== HEADER + size) throw damaged(name, `an image of ${size} bytes`, `${content.length - HEADER}`);
  const [mostX, mostY] = gridSize(camera, scale);
  if (left + width > mostX || top + height > mostY) {
    throw damaged(name, `an image inside ${mostX} x ${mostY} texels`, `${width} x ${height} at (${left}, ${top})`);
  }
  const frame = content.slice(HEADER);
  if (width > 0 && height > 0) checkFrame(frame, width, height, name);
  return { left, top, width, height, frame };
}

/**
 * Checks that a frame is a single, visible VP9 key frame (profile 0) of the declared size.
 * @param {Uint8Array} frame
 * @param {number} width
 * @param {number} height
 * @param {string} name
 */
function checkFrame(frame, width, height, name) {
  const isKey = frame.length >= 10 && (frame[0] | 1) === 0x83 && frame[1] === 0x49 && frame[2] === 0x83 && frame[3] === 0x42;
  if (!isKey || frame[4] >> 5 === 7) throw damaged(name, "a key frame of VP9", "other content");
  const last = frame[frame.length - 1];
  const index = 2 + (((last >> 3) & 3) + 1) * ((last & 7) + 1);
  if ((last & 0xe0) === 0xc0 && frame[frame.length - index] === last) {
    throw damaged(name, "one frame of VP9", "several frames");
  }
  const sides = [4, 6].map((at) => (((frame[at] & 15) << 12) | (frame[at + 1] << 4) | (frame[at + 2] >> 4)) + 1);
  if (sides[0] !== width || sides[1] !== height) {
    throw damaged(name, `a VP9 frame of ${width} x ${height}`, sides.join(" x "));
  }
}

/**
 * @param {StoredImage[]} stored
 * @param {string[]} names
 * @returns {Promise<ViewImage[]>}
 */
async function decodeFrames(stored, names) {
  const missing = missingDecoder();
  if (missing) throw new SceneError(missing);
  /** @type {Map<number, VideoFrame>} */
  const frames = new Map();
  /** @type {string | null} */
  let problem = null;
  const decoder = new VideoDecoder({
    output: (frame) => frames.set(frame.timestamp, frame),
    error: (error) => (problem = error.message),
  });
  try {
    decoder.configure({ codec: CODEC, hardwareAcceleration: "prefer-software", optimizeForLatency: true });
    for (const [index, { frame, width, height }] of stored.entries()) {
      if (width === 0 || height === 0) continue;
      decoder.decode(new EncodedVideoChunk({ type: "key", timestamp: index, data: frame }));
      await decoder.flush().catch((error) => (problem ??= String(error)));
      if (problem !== null || !frames.has(index)) throw damaged(names[index], "an intact VP9 frame", problem ?? "none");
    }
    return await Promise.all(stored.map((image, index) => copyPlanes(image, frames.get(index), names[index])));
  } finally {
    for (const frame of frames.values()) frame.close();
    if (decoder.state !== "closed") decoder.close();
  }
}

/**
 * @param {StoredImage} stored
 * @param {VideoFrame | undefined} frame Undefined for an empty image.
 * @param {string} name
 * @returns {Promise<ViewImage>}
 */
async function copyPlanes({ left, top, width, height }, frame, name) {
  if (!frame) {
    const plane = { bytes: Uint8Array.of(ZERO), offset: 0, stride: 1, step: 1, width: 1, height: 1 };
    return { left, top, planes: [plane, plane, plane] };
  }
  const bytes = new Uint8Array(frame.allocationSize());
  const [luma, second, third] = await frame.copyTo(bytes);
  const half = { bytes, width: (width + 1) >> 1, height: (height + 1) >> 1 };
  const y = { bytes, width, height, step: 1, ...luma };
  if (frame.format === "I420") {
    return { left, top, planes: [y, { ...half, step: 1, ...second }, { ...half, step: 1, ...third }] };
  }
  if (frame.format === "NV12") {
    const odd = { offset: second.offset + 1, stride: second.stride };
    return { left, top, planes: [y, { ...half, step: 2, ...second }, { ...half, step: 2, ...odd }] };
  }
  throw new SceneError(`${name}: expected a decoder of VP9 with the format I420 or NV12, got ${frame.format}; use another browser`);
}

/**
 * @param {Uint8Array} codes (N,) codes of the blend weights.
 * @param {ViewImage} image
 * @param {{xyz: Float32Array, mean: Uint8Array}} base
 * @param {Camera} camera
 * @param {number} scale
 */
function addDifferences(codes, image, { xyz, mean }, camera, scale) {
  const rgba = new Uint8Array(mean);
  const [a, b, c, d] = projection(camera, scale);
  for (let i = 0, at = 0; i < codes.length; i++, at += 4) {
    rgba[at + 3] = codes[i];
    if (codes[i] === 0) continue;
    const [x, y, z] = [xyz[3 * i], xyz[3 * i + 1], xyz[3 * i + 2]];
    const depth = Math.max(a[2] * x + b[2] * y + c[2] * z + d[2], NEAR);
    const u = (a[0] * x + b[0] * y + c[0] * z + d[0]) / depth - image.left;
    const v = (a[1] * x + b[1] * y + c[1] * z + d[1]) / depth - image.top;
    const luma = bilinear(image.planes[0], u, v) - ZERO;
    const cb = bilinear(image.planes[1], u / 2, v / 2) - ZERO;
    const cr = bilinear(image.planes[2], u / 2, v / 2) - ZERO;
    rgba[at] = toByte(mean[at] + luma + RED_FROM_CR * cr);
    rgba[at + 1] = toByte(mean[at + 1] + luma + GREEN_FROM_CB * cb + GREEN_FROM_CR * cr);
    rgba[at + 2] = toByte(mean[at + 2] + luma + BLUE_FROM_CB * cb);
  }
  return rgba;
}

/** @param {number} value */
function toByte(value) {
  return Math.min(Math.max(Math.floor(value + 0.5), 0), 255);
}

/**
 * Returns the columns of the (3, 4) projection matrix of a camera. The matrix maps a world point to
 * (u * depth, v * depth, depth), where (u, v) are texel coordinates of the camera's grid.
 * @param {Camera} camera
 * @param {number} scale
 */
function projection({ intrinsics: k, rotation: r, translation: t }, scale) {
  return [0, 1, 2, 3].map((column) => {
    const vector = column < 3 ? [r[column], r[3 + column], r[6 + column]] : t;
    return [0, 1, 2].map((row) => {
      const value = k[3 * row] * vector[0] + k[3 * row + 1] * vector[1] + k[3 * row + 2] * vector[2];
      return row < 2 ? scale * value : value;
    });
  });
}

/**
 * Samples a plane bilinearly. Texel centres are at half-integers. Beyond the border, the border texels are repeated.
 * @param {Plane} plane
 * @param {number} x
 * @param {number} y
 */
function bilinear({ bytes, offset, stride, step, width, height }, x, y) {
  const px = Math.min(Math.max(x - 0.5, 0), width - 1) || 0;
  const py = Math.min(Math.max(y - 0.5, 0), height - 1) || 0;
  const left = Math.floor(px);
  const top = Math.floor(py);
  const right = step * Math.min(left + 1, width - 1);
  const upper = offset + stride * top;
  const lower = offset + stride * Math.min(top + 1, height - 1);
  const fx = px - left;
  const fy = py - top;
  const above = bytes[upper + step * left] * (1 - fx) + bytes[upper + right] * fx;
  const below = bytes[lower + step * left] * (1 - fx) + bytes[lower + right] * fx;
  return above * (1 - fy) + below * fy;
}
