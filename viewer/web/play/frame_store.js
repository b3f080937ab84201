import { BACKGROUND, baseMembers, describeCloud, normalsMember, viewMember } from "../scene/members.js";
import { Downloads } from "./downloads.js";
/** @typedef {import("../scene/scene_file.js").SceneFile} SceneFile */
/** @typedef {import("../decode/pool.js").DecodePool} DecodePool */
/** @typedef {import("../decode/cloud.js").CloudBase} CloudBase */

const CACHE_BYTES = 256 << 20;
/** Maximum number of frames that are decoded at the same time. */
const CONCURRENT = 4;

/**
 * A frame, or the background. Parts that are not decoded yet are null or missing.
 * @typedef {object} Entry
 * @property {CloudBase | null} base
 * @property {Map<number, Uint8Array<ArrayBuffer>>} views
 * @property {Uint8Array | null} shadow
 * @property {Uint8Array<ArrayBuffer> | null} normals (N, 2) octahedral normals, which are decoded only for styles.
 * @property {boolean} isBusy
 * @property {boolean} hasFailed A failed entry is decoded again only after a call of `retry`.
 * @property {number} used Value of the counter `turn` when the entry was last requested.
 */

/**
 * The frames and the kinds of data to load.
 * @typedef {object} Demand
 * @property {number[]} decoded Frames to decode, in order of urgency.
 * @property {number[]} downloaded Frames to download, in order of urgency. The list starts with those of `decoded`.
 * @property {number[]} views Source views whose colours are needed.
 * @property {boolean} normals Whether the normals are needed.
 * @property {boolean} isPlaying If false, the first frame is downloaded before all others.
 */

/** Downloads and decodes frames in the order in which they are due, and keeps the most recently used ones decoded. */
export class FrameStore {
  /**
   * @param {SceneFile} file
   * @param {DecodePool} pool
   * @param {() => void} changed Called when a part of an entry has been decoded.
   * @param {(error: unknown) => void} failed
   */
  constructor(file, pool, changed, failed) {
    this.file = file;
    this.manifest = file.manifest;
    this.pool = pool;
    this.changed = changed;
    this.failed = failed;
    this.downloads = new Downloads(file, () => this.#start(), failed);
    /** @type {Map<number, Entry>} */
    this.entries = new Map();
    /** Names of the members of each frame. @type {Map<number, {base: string[], views: string[]}>} */
    this.names = new Map();
    this.turn = 0;
    /** @type {number[]} */
    this.wanted = [];
    /** @type {number[]} */
    this.views = [];
    this.needsNormals = false;
    this.hasDecoded = false;
  }

  /**
   * Sets what to load. The background is loaded before the frames.
   * @param {Demand} demand
   */
  want({ decoded, downloaded, views, normals, isPlaying }) {
    const background = this.manifest.background ? [BACKGROUND] : [];
    this.wanted = [...background, ...decoded];
    this.views = views;
    this.needsNormals = normals;
    this.turn++;
    for (const number of this.wanted) this.#entry(number).used = this.turn;
    // Before the first image and after a jump in time, only the frame that is due is downloaded, because downloads of
    // other frames would delay it.
    const isUrgent = decoded.length > 0 && !(isPlaying && this.hasDecoded) && !this.isDrawable(decoded[0]);
    const namesOf = (/** @type {number} */ number) => this.#missing(number, isUrgent ? [] : views);
    this.downloads.want([...background, ...downloaded], namesOf, isUrgent);
    this.#start();
    this.#evict();
  }

  /** Forgets which frames failed to load, so that they are loaded again. */
  retry() {
    this.downloads.retry();
    for (const entry of this.entries.values()) entry.hasFailed = false;
  }

  /** @param {number} frame */
  get(frame) {
    return this.entries.get(frame) ?? null;
  }

  /**
   * Returns true if a frame can be drawn, at least with mean colours.
   * @param {number} frame
   */
  isDrawable(frame) {
    return this.#parts(frame).every((number) => this.#hasBase(number) && this.#hasNormals(number));
  }

  /**
   * Returns true if a frame can be drawn without a style.
   * @param {number} frame
   */
  hasPoints(frame) {
    return this.#parts(frame).every((number) => this.#hasBase(number));
  }

  /**
   * Returns true if a frame can be drawn with the colours of all wanted views.
   * @param {number} frame
   */
  isComplete(frame) {
    return this.#parts(frame).every((number) => this.#isLoaded(number));
  }

  /**
   * Returns the compressed size in bytes of the members of a frame that are still to be downloaded.
   * @param {number} frame
   */
  missingBytes(frame) {
    let bytes = 0;
    for (const name of this.#missing(frame, this.views)) {
      if (!this.downloads.get(frame, name)) bytes += this.file.sizeOf(name);
    }
    return bytes;
  }

  /** Aborts all requests and drops all frames. */
  release() {
    this.wanted = [];
    this.downloads.release();
    this.entries.clear();
  }

  /** @param {number} frame */
  #parts(frame) {
    return this.manifest.background ? [BACKGROUND, frame] : [frame];
  }

  /**
   * @param {number} number
   * @returns {Entry}
   */
  #entry(number) {
    let entry = this.entries.get(number);
    if (!entry) {
      entry = { base: null, views: new Map(), shadow: null, normals: null, isBusy: false, hasFailed: false, used: 0 };
      this.entries.set(number, entry);
    }
    return entry;
  }

  /** @param {number} number */
  #hasBase(number) {
    const entry = this.entries.get(number);
    if (!entry?.base) return false;
    return number === BACKGROUND || !this.manifest.background?.shadow || entry.shadow !== null;
  }

  /** Returns true if the normals of a frame or of the background are decoded or not needed. @param {number} number */
  #hasNormals(number) {
    return !this.needsNormals || (this.entries.get(number)?.normals ?? null) !== null;
  }

  /** @param {number} number */
  #isLoaded(number) {
    return this.#hasBase(number) && this.#hasNormals(number) && this.views.every((view) => this.entries.get(number)?.views.has(view));
  }

  /**
   * Returns the names of the members that are not decoded yet.
   * @param {number} number
   * @param {number[]} views
   */
  #missing(number, views) {
    const { base, views: members } = this.#namesOf(number);
    const decoded = this.entries.get(number)?.views;
    const missing = views.filter((view) => !decoded?.has(view)).map((view) => members[view]);
    const normals = this.#hasNormals(number) ? [] : [normalsMember(this.manifest, number)];
    return [...(this.#hasBase(number) ? [] : base), ...normals, ...missing];
  }

  /** @param {number} number */
  #namesOf(number) {
    let names = this.names.get(number);
    if (!names) {
      const { points, sh, colour, shadow } = baseMembers(this.manifest, number);
      const base = [points, sh, colour, shadow].filter((name) => name !== null);
      names = { base, views: this.manifest.sources.map((_, view) => viewMember(this.manifest, number, view)) };
      this.names.set(number, names);
    }
    return names;
  }

  #start() {
    let busy = [...this.entries.values()].filter((entry) => entry.isBusy).length;
    for (const number of this.wanted) {
      if (busy >= CONCURRENT) return;
      const entry = this.#entry(number);
      if (entry.isBusy || entry.hasFailed) continue;
      const views = this.#decodableViews(number, entry);
      const needsBase = !this.#hasBase(number) && this.downloads.hasAll(number, this.#namesOf(number).base);
      const hasMore = views.length > 0 || this.#normalsToDecode(number) !== null;
      if (!needsBase && (!hasMore || !entry.base)) continue;
      busy++;
      this.#decode(number, entry, needsBase);
    }
  }

  /**
   * Returns the wanted views that are downloaded but not decoded yet.
   * @param {number} number
   * @param {Entry} entry
   */
  #decodableViews(number, entry) {
    const { views } = this.#namesOf(number);
    return this.views.filter((view) => !entry.views.has(view) && this.downloads.get(number, views[view]) !== null);
  }

  /**
   * @param {number} number
   * @param {Entry} entry
   * @param {boolean} needsBase
   */
  async #decode(number, entry, needsBase) {
    entry.isBusy = true;
    try {
      if (needsBase) await this.#decodeBase(number, entry);
      await this.#decodeNormals(number, entry);
      await this.#decodeViews(number, entry);
    } catch (error) {
      entry.hasFailed = true;
      this.downloads.forget(number);
      this.failed(error);
    } finally {
      entry.isBusy = false;
    }
    this.changed();
    this.#start();
  }

  /**
   * @param {number} number
   * @param {Entry} entry
   */
  async #decodeBase(number, entry) {
    const { folder, points, encoding } = describeCloud(this.manifest, number);
    const names = baseMembers(this.manifest, number);
    const member = (/** @type {string} */ name) => /** @type {Uint8Array} */ (this.downloads.get(number, name));
    const colour = names.colour ? member(names.colour) : null;
    const members = { points: member(names.points), sh: member(names.sh), colour };
    const decoding = this.pool.base({ kind: "base", folder, points, encoding, members });
    if (names.shadow) {
      const count = this.manifest.background?.points ?? 0;
      entry.shadow = await this.pool.bytes({ kind: "shadow", size: count, name: names.shadow, member: member(names.shadow) });
    }
    entry.base = await decoding;
    this.hasDecoded = true;
    this.changed();
  }

  /**
   * @param {number} number
   * @param {Entry} entry
   */
  async #decodeViews(number, entry) {
    const views = this.#decodableViews(number, entry);
    if (views.length === 0 || !entry.base) return;
    const { folder, encoding } = describeCloud(this.manifest, number);
    const names = this.#namesOf(number).views;
    const members = views.map((view) => {
      const member = /** @type {Uint8Array} */ (this.downloads.get(number, names[view]));
      return { view, member, camera: this.manifest.sources[view] };
    });
    const { mean } = entry.base;
    const xyz = encoding.imageScale === null ? null : entry.base.xyz;
    for (const [view, rgba] of await this.pool.views({ kind: "views", folder, encoding, mean, xyz, views: members })) {
      entry.views.set(view, rgba);
    }
  }

  /** Returns the normals that are needed and downloaded but not decoded yet, or null. @param {number} number */
  #normalsToDecode(number) {
    return this.#hasNormals(number) ? null : this.downloads.get(number, normalsMember(this.manifest, number));
  }

  /**
   * @param {number} number
   * @param {Entry} entry
   */
  async #decodeNormals(number, entry) {
    const member = this.#normalsToDecode(number);
    if (!member || !entry.base) return;
    const name = normalsMember(this.manifest, number);
    entry.normals = await this.pool.bytes({ kind: "normals", size: 2 * entry.base.points, name, member });
    this.changed();
  }

  #bytes() {
    let total = 0;
    for (const entry of this.entries.values()) total += bytesOf(entry);
    return total;
  }

  /** Drops source views that are not blended, then the least recently used frames. */
  #evict() {
    let total = this.#bytes();
    if (total <= CACHE_BYTES) return;
    for (const { views } of this.entries.values()) {
      for (const view of views.keys()) if (!this.views.includes(view)) views.delete(view);
    }
    total = this.#bytes();
    const oldest = [...this.entries].filter(([, entry]) => entry.used < this.turn && !entry.isBusy);
    oldest.sort(([, a], [, b]) => a.used - b.used);
    for (const [number, entry] of oldest) {
      if (total <= CACHE_BYTES) return;
      total -= bytesOf(entry);
      this.entries.delete(number);
    }
  }
}

/** @param {Entry} entry */
function bytesOf({ base, views, normals }) {
  if (!base) return 0;
  return (normals?.byteLength ?? 0) + base.xyz.byteLength + base.sizes.byteLength + base.factors.byteLength + base.mean.byteLength * (1 + views.size);
}
