import { SceneError } from "./errors.js";
import { JsonNode } from "./json_node.js";
import { largestContent } from "./limits.js";

/**
 * A pinhole camera in OpenCV's convention. Matrices are flat lists in row-major order.
 * @typedef {object} Camera
 * @property {number[]} intrinsics 3 x 3, in pixels.
 * @property {number[]} rotation 3 x 3, R_camera_world.
 * @property {number[]} translation (3,) T_camera_world, in world units.
 * @property {number} width In pixels.
 * @property {number} height In pixels.
 */

/** @typedef {Camera & {name: string}} NamedCamera */

/**
 * Describes how the points of one cloud are quantised. docs/formats.md explains the values.
 * @typedef {object} CloudEncoding
 * @property {number[]} lower
 * @property {number} positionStep
 * @property {number} codeBytes Bytes of a Morton code.
 * @property {number} radiusLower
 * @property {number} radiusSteps
 * @property {number} densityLevels
 * @property {Float32Array} shBasis (shRows, 48), already multiplied by the quantisation step.
 * @property {Float32Array} shMean (48,)
 * @property {number} shRows
 * @property {number} weightSteps
 * @property {number} colourStep
 * @property {boolean} everyPointHasColours
 * @property {number | null} imageScale Resolution of the stored images of source views, in texels per camera pixel.
 *   Null if colours are stored per point.
 */

/**
 * The sound of a scene.
 * @typedef {object} SoundEntry
 * @property {number} start Time of the first sample in seconds from the start of frame 0.
 * @property {number} duration In seconds.
 */

/**
 * @typedef {object} Manifest
 * @property {NamedCamera[]} sources Source views.
 * @property {NamedCamera[]} cameras Source views, then other cameras of the capture.
 * @property {number[]} focus World point (3,) at which the angles between cameras are measured.
 * @property {number[]} points Number of dynamic points of each frame.
 * @property {number} mostPoints Largest number of dynamic points in a frame.
 * @property {number} fps
 * @property {number} layers K, the maximum number of points that are composited per pixel.
 * @property {number} neighbours Number of source views that are blended for a viewing camera.
 * @property {boolean} fadeViews
 * @property {number} shRange
 * @property {number} shBase
 * @property {number} near Smallest depth of points that are drawn, in world units.
 * @property {number} pixelFilter Weight, from 0 to 0.25, of each neighbour in the 3-tap filters along rows and columns.
 * @property {{points: number, shadow: boolean} | null} background
 * @property {boolean} hasNormals
 * @property {SoundEntry | null} sound
 * @property {CloudEncoding} dynamicEncoding
 * @property {CloudEncoding | null} backgroundEncoding
 * @property {Map<string, [number, number]>} members Offset and size in bytes of each member.
 */

export const SH_NUMBERS = 48;
const VERSION = 5;
/** Version of packed scenes whose colours are not stored as images. */
const PACKED_VERSION = 3;
const MAX_POINTS = 1 << 24;
const MAX_FRAMES = 1_000_000;
const MAX_VIEWS = 4096;
const MAX_SECONDS = 1e6;
/** Time in seconds by which the sound may outlast the last frame. */
const SOUND_TOLERANCE = 0.1;

/**
 * Parses and checks the text of a manifest.
 * @param {string} text
 * @returns {Manifest}
 */
export function parseManifest(text) {
  const root = new JsonNode(parseJson(text), "manifest.json");
  checkVersion(root);
  const sources = cameras(root.nodes("source_views", MAX_VIEWS));
  const full = root.text("kind") === "full";
  const described = full ? root.node("background") : null;
  const encoding = root.node("encoding");
  const sh = root.node("sh");
  const points = root.nodes("frames", MAX_FRAMES).map((frame) => frame.integer("points", 0, MAX_POINTS));
  const manifest = {
    sources,
    cameras: [...sources, ...cameras(root.nodes("other_views", MAX_VIEWS))],
    focus: root.numbers("focus", 3),
    points,
    mostPoints: points.reduce((most, count) => Math.max(most, count), 0),
    fps: root.number("fps", 1e-3, 1e4, 30),
    layers: root.integer("layers", 1, 64),
    neighbours: root.integer("neighbours", 1, 64),
    fadeViews: root.flag("fade_views", false),
    shRange: sh.number("range", 0, 1e3),
    shBase: sh.number("base", -1e3, 1e3),
    near: root.number("near", 1e-12, 1e9),
    pixelFilter: root.number("pixel_filter", 0, 0.25, 0),
    background: described && { points: described.integer("points", 0, MAX_POINTS), shadow: described.flag("shadow") },
    hasNormals: hasNormals(root),
    sound: root.has("sound") ? soundEntry(root.node("sound")) : null,
    dynamicEncoding: cloudEncoding(encoding.node("dynamic")),
    backgroundEncoding: full ? cloudEncoding(encoding.node("background")) : null,
    members: members(root.node("members")),
  };
  checkCounts(manifest);
  checkSound(manifest);
  return manifest;
}

/**
 * Checks that the sound ends with the scene.
 * @param {Manifest} manifest
 */
function checkSound({ sound, points, fps }) {
  if (sound && sound.start + sound.duration > points.length / fps + SOUND_TOLERANCE) {
    const end = `got an end at ${sound.start + sound.duration} s`;
    throw new SceneError(`manifest.json, sound: expected sound that ends with the scene, ${end}; export the scene again`);
  }
}

/** @param {JsonNode} root */
function hasNormals(root) {
  const attributes = root.node("attributes");
  if (!("normals" in attributes.content)) return false;
  const normals = attributes.node("normals");
  if (normals.text("dtype") !== "|u1") throw normals.failure("dtype", '"|u1"');
  return true;
}

/**
 * @param {JsonNode} node
 * @returns {SoundEntry}
 */
function soundEntry(node) {
  if (node.text("codec") !== "opus") throw node.failure("codec", '"opus"');
  return { start: node.number("start", 0, MAX_SECONDS), duration: node.number("duration", 0, MAX_SECONDS) };
}

/**
 * Checks that the members are large enough for the declared numbers of points, before memory is reserved for them.
 * @param {Manifest} manifest
 */
function checkCounts({ points, background, members, dynamicEncoding, backgroundEncoding }) {
  const clouds = points.map((count, frame) => ({ folder: frameFolder(frame), count, encoding: dynamicEncoding }));
  if (background && backgroundEncoding) {
    clouds.push({ folder: "background", count: background.points, encoding: backgroundEncoding });
  }
  for (const { folder, count, encoding } of clouds) {
    const range = members.get(`${folder}/points`);
    if (range && count > 0 && count * (encoding.codeBytes + 3) > largestContent(range[1])) {
      const got = `${count} points in ${range[1]} compressed bytes, which cannot contain them`;
      throw new SceneError(`${folder}/points: expected fewer points, got ${got}; export the scene again`);
    }
  }
}

/**
 * Returns the folder of a frame inside the file.
 * @param {number} frame
 */
export function frameFolder(frame) {
  return `frames/${String(frame).padStart(6, "0")}`;
}

/**
 * @param {string} text
 * @returns {unknown}
 */
function parseJson(text) {
  try {
    return JSON.parse(text);
  } catch {
    throw new SceneError("manifest.json: expected JSON, got other content; the scene is damaged: copy it again");
  }
}

/** @param {JsonNode} root */
function checkVersion(root) {
  const format = root.text("format");
  if (format !== "fourd-scene") throw root.failure("format", '"fourd-scene"');
  const version = root.integer("version", 1, 2 ** 31);
  if (version > VERSION) {
    const fix = "update the player with a newer fourd web";
    throw new SceneError(`The scene has format version ${version}, but this player reads version ${VERSION}; ${fix}`);
  }
  if (version < PACKED_VERSION || !root.has("encoding")) {
    throw new SceneError(`The player reads packed scenes, got format version ${version}; use fourd web or fourd pack`);
  }
}

/**
 * @param {JsonNode[]} nodes
 * @returns {NamedCamera[]}
 */
function cameras(nodes) {
  return nodes.map((node) => {
    const camera = {
      name: node.text("name"),
      intrinsics: node.matrix("intrinsics"),
      rotation: node.matrix("rotation"),
      translation: node.numbers("translation", 3),
      width: node.integer("width", 1, 1 << 16),
      height: node.integer("height", 1, 1 << 16),
    };
    if (!(camera.intrinsics[0] > 0 && camera.intrinsics[4] > 0)) throw node.failure("intrinsics", "focal lengths > 0");
    return camera;
  });
}

/**
 * @param {JsonNode} node
 * @returns {CloudEncoding}
 */
function cloudEncoding(node) {
  const shRows = node.integer("sh_rows", 0, SH_NUMBERS);
  const step = node.number("sh_step", 1e-9, 1e3);
  return {
    lower: node.numbers("lower", 3),
    positionStep: node.number("position_step", 1e-30, 1e30),
    codeBytes: Math.ceil((3 * node.integer("position_bits", 1, 21)) / 8),
    radiusLower: node.number("radius_lower", 1e-30, 1e4),
    radiusSteps: node.integer("radius_steps", 1, 1 << 16),
    densityLevels: node.integer("density_levels", 1, 255),
    shBasis: Float32Array.from(node.numbers("sh_basis", shRows * SH_NUMBERS), (value) => Math.fround(value) * step),
    shMean: Float32Array.from(node.numbers("sh_mean", SH_NUMBERS)),
    shRows,
    weightSteps: node.integer("weight_steps", 1, 1 << 16),
    colourStep: node.integer("colour_step", 1, 127),
    everyPointHasColours: node.flag("every_point_has_colours"),
    imageScale: node.has("image_scale") ? node.number("image_scale", 1 / 64, 1) : null,
  };
}

/**
 * @param {JsonNode} node
 * @returns {Map<string, [number, number]>}
 */
function members(node) {
  const found = new Map();
  for (const name of Object.keys(node.content)) {
    const [offset, size] = node.numbers(name, 2);
    if (!(Number.isSafeInteger(offset) && Number.isSafeInteger(size) && offset >= 0 && size >= 0)) {
      throw node.failure(name, "an offset and a size in bytes");
    }
    found.set(name, [offset, size]);
  }
  return found;
}
