import { BACKGROUND } from "../scene/members.js";
/** @typedef {import("../scene/scene_file.js").SceneFile} SceneFile */

/** Maximum size in bytes of the compressed frames in memory. The limit is lower if the device has less than 8 GB of
 * memory, or if the browser does not report its memory. */
const MOST_BYTES = 512 << 20;
const BYTES_PER_GB = 64 << 20;
const SUPPOSED_GB = 4;
/** A new request starts if the data of all running requests should arrive in less than this time, in seconds. */
const SECONDS_IN_FLIGHT = 0.3;
/** Minimum number of simultaneous requests. A single request would leave the connection idle between the last byte of a
 * response and the first byte of the next. */
const FEWEST_JOBS = 2;
const MOST_JOBS = 8;

/** A request in progress. @typedef {{number: number, names: string[], bytes: number, abort: AbortController}} Job */

/** Downloads the members (files in the scene's archive) of several frames at a time, in order of urgency, and keeps
 * them compressed. */
export class Downloads {
  /**
   * @param {SceneFile} file
   * @param {() => void} changed Called when members have arrived, or when a request has failed.
   * @param {(error: unknown) => void} failed
   */
  constructor(file, changed, failed) {
    this.file = file;
    this.changed = changed;
    this.failed = failed;
    this.limit = Math.min(MOST_BYTES, BYTES_PER_GB * (/** @type {any} */ (navigator).deviceMemory ?? SUPPOSED_GB));
    /** Compressed members by name, for each frame and the background. @type {Map<number, Map<string, Uint8Array>>} */
    this.members = new Map();
    this.bytes = 0;
    /** @type {Set<Job>} */
    this.jobs = new Set();
    /** Numbers of the frames, or of the background, whose requests failed. @type {Set<number>} */
    this.failures = new Set();
    /** @type {number[]} */
    this.wanted = [];
    /** @type {(number: number) => string[]} */
    this.namesOf = () => [];
    this.isUrgent = false;
  }

  /**
   * Sets what to download.
   * @param {number[]} wanted The frames and, if needed, the background, in order of urgency.
   * @param {(number: number) => string[]} namesOf Returns the names of the members to download for a frame or for the
   *   background.
   * @param {boolean} isUrgent If true, only the first frame and the background are downloaded.
   */
  want(wanted, namesOf, isUrgent) {
    const first = wanted.find((number) => number !== BACKGROUND);
    this.wanted = isUrgent ? wanted.filter((number) => number === first || number === BACKGROUND) : wanted;
    this.namesOf = namesOf;
    for (const job of this.jobs) if (!this.wanted.includes(job.number)) job.abort.abort();
    this.#start();
  }

  /** @param {number} number @param {string} name */
  get(number, name) {
    return this.members.get(number)?.get(name) ?? null;
  }

  /** @param {string[]} names @param {number} number */
  hasAll(number, names) {
    const found = this.members.get(number);
    return names.every((name) => found?.has(name));
  }

  /** Forgets which requests failed, so that they are sent again. */
  retry() {
    this.failures.clear();
  }

  /** Drops the members of a frame from memory, for example because they cannot be decoded. @param {number} number */
  forget(number) {
    for (const member of this.members.get(number)?.values() ?? []) this.bytes -= member.length;
    this.members.delete(number);
  }

  /** Aborts all requests and drops all members from memory. */
  release() {
    this.wanted = [];
    for (const job of this.jobs) job.abort.abort();
    this.members.clear();
    this.bytes = 0;
  }

  #start() {
    const rate = this.file.source.rate.bytesPerSecond ?? 0;
    for (const number of this.wanted) {
      const { size } = this.jobs;
      if (size >= MOST_JOBS || (size >= FEWEST_JOBS && this.#bytesInFlight() >= rate * SECONDS_IN_FLIGHT)) return;
      if (this.failures.has(number)) continue;
      const names = this.namesOf(number).filter((name) => !this.#isComing(number, name));
      if (names.length && this.#hasRoom(number, names)) this.#load(number, names);
    }
  }

  #bytesInFlight() {
    let bytes = 0;
    for (const job of this.jobs) bytes += job.bytes;
    return bytes;
  }

  /** @param {string[]} names */
  #sizeOf(names) {
    return names.reduce((total, name) => total + this.file.sizeOf(name), 0);
  }

  /** @param {number} number @param {string} name */
  #isComing(number, name) {
    if (this.members.get(number)?.has(name)) return true;
    for (const job of this.jobs) if (job.number === number && job.names.includes(name)) return true;
    return false;
  }

  /** @param {number} number @param {string[]} names */
  async #load(number, names) {
    const job = { number, names, bytes: 0, abort: new AbortController() };
    this.jobs.add(job);
    try {
      job.bytes = this.#sizeOf(names);
      const found = await this.file.read(names, job.abort.signal);
      if (!job.abort.signal.aborted) this.#keep(number, found);
    } catch (error) {
      if (!job.abort.signal.aborted) {
        this.failures.add(number);
        this.failed(error);
      }
    }
    this.jobs.delete(job);
    this.#start();
    this.changed();
  }

  /** @param {number} number @param {Map<string, Uint8Array>} found */
  #keep(number, found) {
    const kept = this.members.get(number) ?? new Map();
    this.members.set(number, kept);
    for (const [name, member] of found) {
      kept.set(name, member);
      this.bytes += member.length;
    }
    while (this.bytes > this.limit) {
      const latest = this.#latest();
      if (latest === null) return;
      this.forget(latest);
    }
  }

  /**
   * Returns true if the members of a frame fit into memory, possibly after dropping frames that are due later.
   * @param {number} number
   * @param {string[]} names
   */
  #hasRoom(number, names) {
    const excess = this.bytes + this.#bytesInFlight() + this.#sizeOf(names) - this.limit;
    if (number === BACKGROUND || excess <= 0) return true;
    let later = 0;
    for (const [other, kept] of this.members) {
      if (other === BACKGROUND || this.#distance(other) <= this.#distance(number)) continue;
      for (const member of kept.values()) later += member.length;
    }
    return later >= excess;
  }

  /** Returns the frame in memory that is due last, under the assumption that playback loops. */
  #latest() {
    let latest = null;
    let most = 0;
    for (const number of this.members.keys()) {
      const distance = this.#distance(number);
      if (number !== BACKGROUND && distance > most) [latest, most] = [number, distance];
    }
    return latest;
  }

  /** Returns the number of frames until a frame is due. @param {number} number */
  #distance(number) {
    const count = this.file.manifest.points.length;
    const current = this.wanted.find((wanted) => wanted !== BACKGROUND) ?? 0;
    return (number - current + count) % count;
  }
}
