import { SceneError } from "../scene/errors.js";
/** @typedef {import("./depth_order.js").SortCamera} SortCamera */

/**
 * @typedef {{cloud: number, first: number, radius: number, xyz: Float32Array}} SortCloud
 * @typedef {{clouds: {cloud: number, first: number, radius: number}[], camera: SortCamera,
 *   uploads: {cloud: number, xyz: Float32Array}[]}} SortRequest
 * @typedef {{points: Uint32Array<ArrayBuffer>, ratio: number}} SortedPoints Indices of the visible points, nearest
 *   first, and an upper bound of radius / depth over these points.
 * @typedef {SortedPoints & {ms: number}} SortReply
 */

/** Sorts points by depth in a worker thread, one request at a time. */
export class Sorter {
  constructor() {
    this.worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
    this.worker.onmessage = (/** @type {MessageEvent<SortReply>} */ event) => this.#receive(event.data);
    this.worker.onerror = (event) => this.reject?.(new SceneError(`Sorting failed: ${event.message}; reload the page`));
    /** @type {Set<number>} Numbers of the clouds whose positions the worker has. */
    this.kept = new Set();
    this.ms = 0;
    /** @type {((sorted: SortedPoints) => void) | undefined} */
    this.resolve = undefined;
    /** @type {((error: Error) => void) | undefined} */
    this.reject = undefined;
  }

  /** Whether a request is in progress. */
  get isBusy() {
    return this.resolve !== undefined;
  }

  /**
   * @param {SortCloud[]} clouds Clouds with the same number have the same positions.
   * @param {SortCamera} camera
   * @returns {Promise<SortedPoints>}
   */
  sort(clouds, camera) {
    const uploads = clouds.filter(({ cloud }) => !this.kept.has(cloud)).map(({ cloud, xyz }) => ({ cloud, xyz }));
    this.kept = new Set(clouds.map(({ cloud }) => cloud));
    return new Promise((resolve, reject) => {
      this.resolve = resolve;
      this.reject = reject;
      const listed = clouds.map(({ cloud, first, radius }) => ({ cloud, first, radius }));
      this.worker.postMessage({ clouds: listed, camera, uploads });
    });
  }

  release() {
    this.worker.terminate();
  }

  /** @param {SortReply} reply */
  #receive(reply) {
    const { resolve } = this;
    this.resolve = this.reject = undefined;
    this.ms = reply.ms;
    resolve?.(reply);
  }
}
