import { frameFolder } from "../scene/manifest.js";
/** @typedef {import("../scene/scene_file.js").SceneFile} SceneFile */
/** @typedef {import("../decode/pool.js").DecodePool} DecodePool */
/** @typedef {import("../decode/cloud.js").CloudBase} CloudBase */
/** @typedef {import("../scene/manifest.js").CloudEncoding} CloudEncoding */

const CACHE_BYTES = 256 << 20;
/** Number of frames that are fetched and decoded at the same time. */
const CONCURRENT = 4;

/** The number that identifies the background in the store. */
export const BACKGROUND = -1;

/**
 * A frame, or the background. Parts are null or missing until they are decoded.
 * @typedef {object} Entry
 * @property {CloudBase | null} base
 * @property {Map<number, Uint8Array<ArrayBuffer>>} views
 * @property {Uint8Array | null} shadow
 * @property {boolean} isBusy
 * @property {boolean} hasFailed A failed entry is loaded again only after a call of `retry`.
 * @property {AbortController | null} abort
 * @property {number} used Counter value of the last request for the entry.
 */

/** Fetches and decodes frames, nearest first, and keeps the most recently used frames. */
export class FrameStore {
  /**
   * @param {SceneFile} file
   * @param {DecodePool} pool
   * @param {() => void} changed Called when a part has arrived.
   * @param {(error: unknown) => void} failed
   */
  constructor(file, pool, changed, failed) {
    this.file = file;
    this.manifest = file.manifest;
    this.pool = pool;
    this.changed = changed;
    this.failed = failed;
    /** @type {Map<number, Entry>} */
    this.entries = new Map();
    this.turn = 0;
    /** @type {number[]} */
    this.wanted = [];
    /** @type {number[]} */
    this.views = [];
  }

  /**
   * Sets what to load: the background, then frames in order of urgency, each with the colours of some source views.
   * @param {number[]} frames
   * @param {number[]} views
   */
  want(frames, views) {
    this.wanted = this.manifest.background ? [BACKGROUND, ...frames] : frames;
    this.views = views;
    this.turn++;
    for (const number of this.wanted) this.#entry(number).used = this.turn;
    for (const [number, entry] of this.entries) {
      if (entry.isBusy && !this.wanted.includes(number)) entry.abort?.abort();
    }
    this.#start();
    this.#evict();
  }

  /** Allows failed frames to be loaded again. */
  retry() {
    for (const entry of this.entries.values()) entry.hasFailed = false;
  }

  /** @param {number} frame */
  get(frame) {
    return this.entries.get(frame) ?? null;
  }

  /**
   * Whether a frame can be drawn, if necessary with mean colours.
   * @param {number} frame
   */
  isDrawable(frame) {
    return this.#parts(frame).every((entry) => entry?.base && this.#hasShadow(entry, frame));
  }

  /**
   * Whether a frame has the colours of all wanted views.
   * @param {number} frame
   */
  isComplete(frame) {
    return this.isDrawable(frame) && this.#parts(frame).every((entry) => this.views.every((view) => entry?.views.has(view)));
  }

  /** @param {number} frame */
  #parts(frame) {
    return this.manifest.background ? [this.get(BACKGROUND), this.get(frame)] : [this.get(frame)];
  }

  /**
   * @param {Entry | null} entry
   * @param {number} frame
   */
  #hasShadow(entry, frame) {
    return !this.manifest.background?.shadow || entry !== this.get(frame) || entry?.shadow !== null;
  }

  /**
   * @param {number} number
   * @returns {Entry}
   */
  #entry(number) {
    let entry = this.entries.get(number);
    if (!entry) {
      entry = { base: null, views: new Map(), shadow: null, isBusy: false, hasFailed: false, abort: null, used: 0 };
      this.entries.set(number, entry);
    }
    return entry;
  }

  /** Whether the first wanted frame cannot be drawn yet. */
  #isUrgent() {
    const first = this.wanted.find((number) => number !== BACKGROUND);
    return first !== undefined && !this.isDrawable(first);
  }

  #start() {
    let busy = [...this.entries.values()].filter((entry) => entry.isBusy).length;
    // Until the first wanted frame can be drawn, only this frame and the background are fetched.
    const limit = this.#isUrgent() ? (this.manifest.background ? 2 : 1) : CONCURRENT;
    for (const number of this.wanted) {
      if (busy >= limit) return;
      const entry = this.#entry(number);
      if (entry.isBusy || entry.hasFailed || this.#isLoaded(number, entry)) continue;
      busy++;
      this.#load(number, entry);
    }
  }

  /**
   * @param {number} number
   * @param {Entry} entry
   */
  #isLoaded(number, entry) {
    const needsShadow = number !== BACKGROUND && this.manifest.background?.shadow;
    return entry.base && (!needsShadow || entry.shadow) && this.views.every((view) => entry.views.has(view));
  }

  /**
   * @param {number} number
   * @param {Entry} entry
   */
  async #load(number, entry) {
    entry.isBusy = true;
    entry.abort = new AbortController();
    const { signal } = entry.abort;
    try {
      if (!entry.base && this.#isUrgent()) await this.#loadBase(number, entry, signal);
      const views = this.views.filter((view) => !entry.views.has(view));
      const reading = this.#readViews(number, views, signal);
      reading.catch(() => {}); // The error is reported by the code that awaits the views.
      if (!entry.base) await this.#loadBase(number, entry, signal);
      await this.#decodeViews(number, entry, views, await reading);
    } catch (error) {
      entry.hasFailed = !signal.aborted;
      if (entry.hasFailed) this.failed(error);
    } finally {
      entry.isBusy = false;
    }
    this.changed();
    this.#start();
  }

  /**
   * @param {number} number
   * @param {Entry} entry
   * @param {AbortSignal} signal
   */
  async #loadBase(number, entry, signal) {
    const { folder, points, encoding } = this.#describe(number);
    const names = [`${folder}/points`, `${folder}/sh`];
    if (this.manifest.sources.length) names.push(`${folder}/colour`);
    const shadowed = number !== BACKGROUND && this.manifest.background?.shadow ? `${folder}/shadow` : null;
    const found = await this.file.read(shadowed ? [...names, shadowed] : names, signal);
    const [pointsMember, sh, colour] = names.map((name) => /** @type {Uint8Array} */ (found.get(name)));
    const members = { points: pointsMember, sh, colour: colour ?? null };
    const decoding = this.pool.base({ kind: "base", folder, points, encoding, members });
    if (shadowed) {
      const member = /** @type {Uint8Array} */ (found.get(shadowed));
      const count = this.manifest.background?.points ?? 0;
      entry.shadow = await this.pool.shadow({ kind: "shadow", folder, points: count, member });
    }
    entry.base = await decoding;
    this.changed();
  }

  /**
   * @param {number} number
   * @param {number[]} views
   * @param {AbortSignal} signal
   */
  async #readViews(number, views, signal) {
    const { folder } = this.#describe(number);
    const found = await this.file.read(views.map((view) => viewMember(folder, view)), signal);
    return views.map((view) => ({ view, member: /** @type {Uint8Array} */ (found.get(viewMember(folder, view))) }));
  }

  /**
   * @param {number} number
   * @param {Entry} entry
   * @param {number[]} views
   * @param {{view: number, member: Uint8Array}[]} members
   */
  async #decodeViews(number, entry, views, members) {
    if (views.length === 0 || !entry.base) return;
    const { folder, encoding } = this.#describe(number);
    const request = { kind: /** @type {const} */ ("views"), folder, encoding, mean: entry.base.mean, views: members };
    for (const [view, rgba] of await this.pool.views(request)) entry.views.set(view, rgba);
  }

  /** @param {number} number */
  #describe(number) {
    const { manifest } = this;
    if (number === BACKGROUND) {
      const encoding = /** @type {CloudEncoding} */ (manifest.backgroundEncoding);
      return { folder: "background", points: manifest.background?.points ?? 0, encoding };
    }
    const folder = frameFolder(number);
    return { folder, points: manifest.points[number], encoding: manifest.dynamicEncoding };
  }

  /** Aborts all requests and drops all frames. */
  release() {
    this.wanted = [];
    for (const entry of this.entries.values()) entry.abort?.abort();
    this.entries.clear();
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
function bytesOf({ base, views }) {
  if (!base) return 0;
  return base.xyz.byteLength + base.sizes.byteLength + base.factors.byteLength + base.mean.byteLength * (1 + views.size);
}

/**
 * @param {string} folder
 * @param {number} view
 */
function viewMember(folder, view) {
  return `${folder}/views/${String(view).padStart(3, "0")}`;
}
