import { damaged, inflate, inflateExactly } from "./inflate.js";
/** @typedef {import("../scene/manifest.js").CloudEncoding} CloudEncoding */

/**
 * The points of a cloud without its source views.
 * @typedef {object} CloudBase
 * @property {number} points
 * @property {Float32Array<ArrayBuffer>} xyz (N, 3) in world units.
 * @property {Uint32Array<ArrayBuffer>} sizes One number per point, with the radius code in the low 16 bits and the
 *   density code in the next 8 bits.
 * @property {Int16Array<ArrayBuffer>} factors (K, N): the factors by which each point multiplies the K rows of the
 *   basis of its spherical harmonics.
 * @property {Uint8Array<ArrayBuffer>} mean (N, 4) mean colour over the source views; the fourth byte is 0.
 * @property {number} largestRadius Largest radius of a point in world units.
 */

/** Upper limit of radii in world units, so that projected radii are finite floats. */
const MAX_RADIUS = 1e18;

/** Lookup table that gathers the coordinate bits of 12 bits of a Morton code. The lowest 4 bits of an entry belong to
 * x, the next 4 to y, and the highest 4 to z. */
const GATHERED = gatherTable();

function gatherTable() {
  const table = new Uint16Array(4096);
  for (let code = 0; code < 4096; code++) {
    let value = 0;
    for (let bit = 0; bit < 4; bit++) {
      for (let axis = 0; axis < 3; axis++) value |= ((code >> (3 * bit + axis)) & 1) << (4 * axis + bit);
    }
    table[code] = value;
  }
  return table;
}

/**
 * Decodes the members `points`, `sh` and `colour`, which docs/formats.md describes.
 * @param {{points: Uint8Array, sh: Uint8Array, colour: Uint8Array | null}} members
 * @param {number} points
 * @param {CloudEncoding} encoding
 * @param {string} folder
 * @returns {Promise<CloudBase>}
 */
export async function decodeBase(members, points, encoding, folder) {
  const [content, factors, mean] = await Promise.all([
    inflateExactly(members.points, points * (encoding.codeBytes + 3), `${folder}/points`),
    inflateExactly(members.sh, 2 * encoding.shRows * points, `${folder}/sh`),
    members.colour ? inflateExactly(members.colour, 3 * points, `${folder}/colour`) : new Uint8Array(3 * points),
  ]);
  const sizes = decodeSizes(content.subarray(points * encoding.codeBytes), points);
  const largest = sizes.reduce((code, size) => Math.max(code, size & 0xffff), 0);
  const largestRadius = largest === 0 ? 0 : encoding.radiusLower * 2 ** ((largest - 1) / encoding.radiusSteps);
  if (!(largestRadius < MAX_RADIUS)) throw damaged(`${folder}/points`, `radii below ${MAX_RADIUS.toExponential()}`, String(largestRadius));
  return {
    points,
    xyz: decodePositions(content, points, encoding),
    sizes,
    factors: decodeFactors(factors),
    mean: decodeMean(mean, points),
    largestRadius,
  };
}

/**
 * Decodes one source view of a cloud.
 * @param {Uint8Array} member
 * @param {Uint8Array} mean (N, 4)
 * @param {CloudEncoding} encoding
 * @param {string} name
 * @returns {Promise<Uint8Array<ArrayBuffer>>} (N, 4): red, green, blue, and the code of the blend weight.
 */
export async function decodeView(member, mean, encoding, name) {
  const points = mean.length / 4;
  const content = await inflate(member, 4 * points, name);
  const colours = encoding.everyPointHasColours ? points : countNonzero(content.subarray(0, points));
  if (content.length !== points + 3 * colours) {
    throw damaged(name, `${points + 3 * colours} bytes`, `${content.length}`);
  }
  return addLevels(content, colours, mean, encoding);
}

/**
 * @param {Uint8Array} content
 * @param {number} colours
 * @param {Uint8Array} mean
 * @param {CloudEncoding} encoding
 */
function addLevels(content, colours, mean, encoding) {
  const points = mean.length / 4;
  const step = encoding.colourStep;
  const all = encoding.everyPointHasColours;
  const rgba = new Uint8ClampedArray(mean);
  const wrapped = new Uint8Array(rgba.buffer);
  let green = points;
  for (let i = 0, at = 0; i < points; i++, at += 4) {
    const code = content[i];
    wrapped[at + 3] = code;
    if (code === 0 && !all) continue;
    const level = content[green];
    const red = (content[green + colours] + level) << 24 >> 24;
    const blue = (content[green + 2 * colours] + level) << 24 >> 24;
    // If the colour step is 1, sums are modulo 256. For larger steps, they are clamped to the range from 0 to 255.
    const target = step === 1 ? wrapped : rgba;
    target[at] = mean[at] + step * red;
    target[at + 1] = mean[at + 1] + step * (level << 24 >> 24);
    target[at + 2] = mean[at + 2] + step * blue;
    green++;
  }
  return wrapped;
}

/** @param {Uint8Array} codes */
function countNonzero(codes) {
  let count = 0;
  for (let i = 0; i < codes.length; i++) count += codes[i] !== 0 ? 1 : 0;
  return count;
}

/**
 * Adds up the differences of Morton codes, and gathers the bits of each coordinate. As codes have up to 63 bits, a sum
 * is stored in three 24-bit integers, each of which contains 8 bits of every coordinate.
 * @param {Uint8Array} content
 * @param {number} points
 * @param {CloudEncoding} encoding
 */
function decodePositions(content, points, encoding) {
  const { codeBytes, positionStep, lower } = encoding;
  const xyz = new Float32Array(3 * points);
  const [lowerX, lowerY, lowerZ] = lower;
  /** @type {(plane: number, i: number) => number} */
  const byte = (plane, i) => (plane < codeBytes ? content[plane * points + i] : 0);
  let low = 0;
  let middle = 0;
  let high = 0;
  for (let i = 0; i < points; i++) {
    low += byte(0, i) | (byte(1, i) << 8) | (byte(2, i) << 16);
    middle += (byte(3, i) | (byte(4, i) << 8) | (byte(5, i) << 16)) + (low >>> 24);
    high += (byte(6, i) | (byte(7, i) << 8)) + (middle >>> 24);
    low &= 0xffffff;
    middle &= 0xffffff;
    high &= 0xffffff;
    const a = GATHERED[low & 0xfff];
    const b = GATHERED[low >> 12];
    const c = GATHERED[middle & 0xfff];
    const d = GATHERED[middle >> 12];
    const e = GATHERED[high & 0xfff];
    const f = GATHERED[high >> 12];
    const x = (a & 15) | ((b & 15) << 4) | ((c & 15) << 8) | ((d & 15) << 12) | ((e & 15) << 16) | ((f & 15) << 20);
    const y = ((a >> 4) & 15) | (b & 240) | ((c & 240) << 4) | ((d & 240) << 8) | ((e & 240) << 12) | ((f & 240) << 16);
    const z = (a >> 8) | ((b >> 8) << 4) | ((c >> 8) << 8) | ((d >> 8) << 12) | ((e >> 8) << 16) | ((f >> 8) << 20);
    xyz[3 * i] = lowerX + x * positionStep;
    xyz[3 * i + 1] = lowerY + y * positionStep;
    xyz[3 * i + 2] = lowerZ + z * positionStep;
  }
  return xyz;
}

/**
 * @param {Uint8Array} content
 * @param {number} points
 */
function decodeSizes(content, points) {
  const sizes = new Uint32Array(points);
  for (let i = 0; i < points; i++) {
    sizes[i] = content[i] | (content[points + i] << 8) | (content[2 * points + i] << 16);
  }
  return sizes;
}

/** @param {Uint8Array} content */
function decodeFactors(content) {
  const count = content.length / 2;
  const factors = new Int16Array(count);
  for (let i = 0; i < count; i++) {
    const code = content[i] | (content[count + i] << 8);
    factors[i] = (code >> 1) ^ -(code & 1);
  }
  return factors;
}

/**
 * @param {Uint8Array} content
 * @param {number} points
 */
function decodeMean(content, points) {
  const mean = new Uint8Array(4 * points);
  let green = 0;
  let red = 0;
  let blue = 0;
  for (let i = 0; i < points; i++) {
    green += content[i];
    red += content[points + i];
    blue += content[2 * points + i];
    mean[4 * i] = red + green;
    mean[4 * i + 1] = green;
    mean[4 * i + 2] = blue + green;
  }
  return mean;
}
