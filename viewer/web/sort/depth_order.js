/**
 * A camera whose view frustum, enlarged by a border, selects the points to sort. Points outside it are dropped.
 * @typedef {object} SortCamera
 * @property {number[]} rotation 3 x 3, R_camera_world.
 * @property {number[]} translation (3,) T_camera_world, in world units.
 * @property {number[]} intrinsics 3 x 3, in pixels.
 * @property {number} width
 * @property {number} height
 * @property {number} near Smallest depth in world units.
 * @property {number} border Width in pixels of the border around the image.
 */

/** The upper bound of radius / depth is multiplied by this factor, because the camera can move nearer to the points
 * before the next sort. */
const RATIO_MARGIN = 1.1;
const BITS = 11;
const BUCKETS = 1 << BITS;

/** Sorts points by depth with a stable radix sort, so that points of equal depth keep their order. */
export class DepthOrder {
  constructor() {
    this.capacity = 0;
    this.keys = new Uint32Array(0);
    this.otherKeys = new Uint32Array(0);
    this.indices = new Uint32Array(0);
    this.otherIndices = new Uint32Array(0);
  }

  /**
   * @param {{xyz: Float32Array, first: number, radius: number}[]} clouds For each cloud: positions (N, 3), the index of
   *   the first point, and the largest radius in world units.
   * @param {SortCamera} camera
   * @returns {import("./sorter.js").SortedPoints}
   */
  sort(clouds, camera) {
    this.#reserve(clouds.reduce((sum, cloud) => sum + cloud.xyz.length / 3, 0));
    let count = 0;
    let ratio = 0;
    for (const cloud of clouds) {
      const first = count;
      count = this.#select(cloud, camera, count);
      if (count > first) ratio = Math.max(ratio, cloud.radius / this.#nearest(first, count));
    }
    return { points: this.#radixSort(count).slice(0, count), ratio: RATIO_MARGIN * ratio };
  }

  /** @param {number} count */
  #reserve(count) {
    if (count <= this.capacity) return;
    this.capacity = count;
    this.keys = new Uint32Array(count);
    this.otherKeys = new Uint32Array(count);
    this.indices = new Uint32Array(count);
    this.otherIndices = new Uint32Array(count);
  }

  /**
   * @param {{xyz: Float32Array, first: number, radius: number}} cloud
   * @param {SortCamera} camera
   * @param {number} count
   */
  #select({ xyz, first, radius }, camera, count) {
    const [r0, r1, r2, r3, r4, r5, r6, r7, r8] = camera.rotation;
    const [t0, t1, t2] = camera.translation;
    const [fx, skew, cx, , fy, cy] = camera.intrinsics;
    const { near, border } = camera;
    const left = -border - cx;
    const right = camera.width + border - cx;
    const top = -border - cy;
    const bottom = camera.height + border - cy;
    const reach = fy * radius; // A disc can extend into the image even if its centre is outside.
    const { keys, indices } = this;
    const depth = new Float32Array(1);
    const bits = new Uint32Array(depth.buffer);
    for (let i = 0, at = 0; at < xyz.length; i++, at += 3) {
      const x = xyz[at];
      const y = xyz[at + 1];
      const z = xyz[at + 2];
      const viewZ = r6 * x + r7 * y + r8 * z + t2;
      if (!(viewZ >= near)) continue;
      const viewX = r0 * x + r1 * y + r2 * z + t0;
      const viewY = r3 * x + r4 * y + r5 * z + t1;
      const u = fx * viewX + skew * viewY;
      const v = fy * viewY;
      if (u < left * viewZ - reach || u > right * viewZ + reach) continue;
      if (v < top * viewZ - reach || v > bottom * viewZ + reach) continue;
      depth[0] = viewZ;
      keys[count] = bits[0]; // Positive floats have the same order as their bits when read as integers.
      indices[count++] = first + i;
    }
    return count;
  }

  /**
   * Returns the smallest depth among the keys from `first` to `end`.
   * @param {number} first
   * @param {number} end
   */
  #nearest(first, end) {
    const bits = Uint32Array.of(0xffffffff);
    for (let i = first; i < end; i++) if (this.keys[i] < bits[0]) bits[0] = this.keys[i];
    return new Float32Array(bits.buffer)[0];
  }

  /** @param {number} count */
  #radixSort(count) {
    let from = this.keys;
    let to = this.otherKeys;
    let fromIndices = this.indices;
    let toIndices = this.otherIndices;
    const starts = new Uint32Array(BUCKETS);
    for (let shift = 0; shift < 33; shift += BITS) {
      starts.fill(0);
      for (let i = 0; i < count; i++) starts[(from[i] >>> shift) & (BUCKETS - 1)]++;
      let sum = 0;
      for (let bucket = 0; bucket < BUCKETS; bucket++) {
        const size = starts[bucket];
        starts[bucket] = sum;
        sum += size;
      }
      for (let i = 0; i < count; i++) {
        const key = from[i];
        const at = starts[(key >>> shift) & (BUCKETS - 1)]++;
        to[at] = key;
        toIndices[at] = fromIndices[i];
      }
      [from, to, fromIndices, toIndices] = [to, from, toIndices, fromIndices];
    }
    return fromIndices;
  }
}
