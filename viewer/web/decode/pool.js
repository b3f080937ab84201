import { SceneError } from "../scene/errors.js";
/** @typedef {import("../scene/manifest.js").CloudEncoding} CloudEncoding */
/** @typedef {import("../scene/manifest.js").Camera} Camera */
/** @typedef {import("./cloud.js").CloudBase} CloudBase */

/**
 * @typedef {{kind: "base", folder: string, points: number, encoding: CloudEncoding,
 *   members: {points: Uint8Array, sh: Uint8Array, colour: Uint8Array | null}}} BaseRequest
 * @typedef {{kind: "views", folder: string, encoding: CloudEncoding, mean: Uint8Array, xyz: Float32Array | null,
 *   views: {view: number, member: Uint8Array, camera: Camera}[]}} ViewsRequest `xyz` is needed only if colours are
 *   sampled from images.
 * @typedef {{kind: "shadow" | "normals", size: number, name: string, member: Uint8Array}} BytesRequest
 * @typedef {(BaseRequest | ViewsRequest | BytesRequest) & {id?: number}} DecodeRequest
 * @typedef {CloudBase | [number, Uint8Array<ArrayBuffer>][] | Uint8Array<ArrayBuffer>} DecodeResult
 * @typedef {{id?: number, result?: DecodeResult, error?: string, ms: number}} DecodeReply
 */

/** Decodes members in worker threads. */
export class DecodePool {
  /** @param {number} [count] Number of workers. */
  constructor(count = Math.min(Math.max((navigator.hardwareConcurrency ?? 2) - 1, 1), 4)) {
    /** @type {Map<number, {resolve: (result: any) => void, reject: (error: Error) => void, worker: number}>} */
    this.waiting = new Map();
    this.load = new Array(count).fill(0);
    this.next = 0;
    /** For each kind of request: [total milliseconds of decoding, number of requests]. */
    this.times = { base: [0, 0], views: [0, 0], shadow: [0, 0], normals: [0, 0] };
    this.workers = this.load.map((_, index) => this.#start(index));
  }

  /**
   * @param {BaseRequest} request
   * @returns {Promise<CloudBase>}
   */
  base(request) {
    return this.#send(request);
  }

  /**
   * @param {ViewsRequest} request
   * @returns {Promise<[number, Uint8Array<ArrayBuffer>][]>}
   */
  views(request) {
    return this.#send(request);
  }

  /**
   * Decompresses a member that is a plain array of bytes.
   * @param {BytesRequest} request
   * @returns {Promise<Uint8Array<ArrayBuffer>>}
   */
  bytes(request) {
    return this.#send(request);
  }

  release() {
    for (const worker of this.workers) worker.terminate();
    for (const { reject } of this.waiting.values()) reject(new SceneError("The player was closed"));
    this.waiting.clear();
  }

  /** @param {number} index */
  #start(index) {
    const worker = new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
    worker.onmessage = (/** @type {MessageEvent<DecodeReply>} */ event) => this.#receive(event.data);
    worker.onerror = (event) => this.#fail(index, event.message || "the worker cannot be loaded");
    return worker;
  }

  /**
   * @param {DecodeRequest} request
   * @returns {Promise<any>}
   */
  #send(request) {
    const id = this.next++;
    const worker = this.load.indexOf(Math.min(...this.load));
    this.load[worker]++;
    return new Promise((resolve, reject) => {
      this.waiting.set(id, {
        worker,
        reject,
        resolve: (reply) => {
          const time = this.times[request.kind];
          time[0] += reply.ms;
          time[1]++;
          resolve(reply.result);
        },
      });
      this.workers[worker].postMessage({ ...request, id });
    });
  }

  /** @param {DecodeReply} reply */
  #receive(reply) {
    const waiting = this.waiting.get(reply.id ?? -1);
    if (!waiting) return;
    this.waiting.delete(reply.id ?? -1);
    this.load[waiting.worker]--;
    if (reply.error !== undefined) waiting.reject(new SceneError(reply.error));
    else waiting.resolve(reply);
  }

  /**
   * @param {number} index
   * @param {string} message
   */
  #fail(index, message) {
    for (const [id, waiting] of this.waiting) {
      if (waiting.worker !== index) continue;
      this.waiting.delete(id);
      waiting.reject(new SceneError(`Decoding failed: ${message}; reload the page`));
    }
    this.load[index] = 0;
  }
}
