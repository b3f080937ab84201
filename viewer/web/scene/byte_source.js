import { ChangedError, SceneError } from "./errors.js";
import { LineRate } from "./line_rate.js";

const ATTEMPTS = 3;
const WHOLE_FILE_LIMIT = 2 ** 30;

/** @typedef {{offset: number, size: number}} ByteRange */

/**
 * Reads byte ranges of a file over HTTP.
 *
 * If the server ignores ranges and sends the whole file, it is kept in memory, and ranges are read from it while the
 * data arrives. A read fails with a SceneError if the server stalls, or if the file ends early or changes.
 */
export class ByteSource {
  /**
   * @param {string} url
   * @param {number} stallMs Time in milliseconds without data after which a request is repeated.
   */
  constructor(url, stallMs) {
    this.url = url;
    this.stallMs = stallMs;
    /** @type {WholeFile | null} */
    this.whole = null;
    /** ETag or date of the file, and its size. @type {{tag: string | null, size: string | null} | null} */
    this.version = null;
    /** The size of the file in bytes, or null if the server sends no Content-Range. @type {number | null} */
    this.size = null;
    this.bytesReceived = 0;
    this.rate = new LineRate();
  }

  /**
   * @param {number} offset
   * @param {number} size
   * @param {AbortSignal} [signal]
   * @returns {Promise<Uint8Array>} The bytes of the range, or fewer if the file ends inside the range.
   */
  async read(offset, size, signal) {
    if (size === 0) return new Uint8Array(0);
    for (let attempt = 1; ; attempt++) {
      try {
        if (this.whole) return await this.whole.read(offset, size);
        return await this.#request(offset, size, signal);
      } catch (error) {
        if (signal?.aborted || error instanceof SceneError) throw error;
        if (attempt === ATTEMPTS) throw new SceneError(`${this.url}: ${networkProblem(error)}; reload the page`);
        this.whole = null;
        await sleep(300 * attempt);
      }
    }
  }

  /**
   * Reads `size` bytes, and throws an error if fewer bytes arrive.
   * @param {number} offset
   * @param {number} size
   * @param {AbortSignal} [signal]
   */
  async readExactly(offset, size, signal) {
    const bytes = await this.read(offset, size, signal);
    if (bytes.length !== size) {
      const end = offset + bytes.length;
      throw new SceneError(`${this.url}: expected at least ${offset + size} bytes, got ${end}; copy the file again`);
    }
    return bytes;
  }

  /** Returns true if the file on the server has changed. Returns false if the server does not answer. */
  async hasChanged() {
    try {
      const response = await fetch(this.url, { method: "HEAD", cache: "no-store" });
      return response.ok && this.version !== null && tagOf(response) !== this.version.tag;
    } catch {
      return false;
    }
  }

  /**
   * @param {number} offset
   * @param {number} size
   * @param {AbortSignal} [signal]
   * @returns {Promise<Uint8Array>}
   */
  async #request(offset, size, signal) {
    const stall = new Stall(this.stallMs, signal);
    this.rate.begin();
    try {
      const headers = { Range: `bytes=${offset}-${offset + size - 1}` };
      const response = await fetch(this.url, { headers, signal: stall.signal, cache: "no-cache" });
      stall.reset();
      if (response.status === 416) {
        const size = response.headers.get("Content-Range")?.split("/")[1];
        if (this.version && size !== undefined && size !== this.version.size) throw new ChangedError();
        return new Uint8Array(0);
      }
      if (response.status !== 200 && response.status !== 206) {
        const got = `HTTP status ${response.status}`;
        if (response.status >= 500) throw new Error(`the server answers with ${got}`);
        throw new SceneError(`${this.url}: expected a scene, got ${got}; check the address`);
      }
      this.#checkVersion(response);
      if (response.status === 206) return await this.#collect(response, size, stall);
      stall.release();
      if (!this.whole) {
        this.whole = new WholeFile(response, this.stallMs, (count) => this.#receive(count));
        this.rate.begin();
        this.whole.end.then(() => this.rate.end());
      }
      return await this.whole.read(offset, size);
    } catch (error) {
      // A browser may report that the body was aborted in place of the reason.
      throw stall.signal.reason instanceof Error && !signal?.aborted ? stall.signal.reason : error;
    } finally {
      this.rate.end();
      stall.release();
    }
  }

  /** @param {number} count */
  #receive(count) {
    this.bytesReceived += count;
    this.rate.receive(count);
  }

  /** @param {Response} response */
  #checkVersion(response) {
    const { headers } = response;
    const total = headers.get("Content-Range")?.split("/")[1];
    const size = total ?? headers.get("Content-Length");
    const tag = tagOf(response);
    if (this.version && (this.version.tag !== tag || this.version.size !== size)) throw new ChangedError();
    this.version = { tag, size };
    this.size = /^\d{1,15}$/.test(total ?? "") ? Number(total) : null;
  }

  /**
   * @param {Response} response
   * @param {number} size
   * @param {Stall} stall
   */
  async #collect(response, size, stall) {
    const declared = /^bytes (\d+)-(\d+)\//.exec(response.headers.get("Content-Range") ?? "");
    const expected = declared ? Number(declared[2]) - Number(declared[1]) + 1 : size;
    if (!(expected <= size)) throw new Error("the server sends more than requested");
    const bytes = new Uint8Array(expected);
    let count = 0;
    for await (const chunk of chunks(response)) {
      stall.reset();
      if (count + chunk.length > expected) throw new Error("the server sends more than it announced");
      bytes.set(chunk, count);
      count += chunk.length;
      this.#receive(chunk.length);
    }
    if (count < expected) throw new Error("the connection ended early");
    return bytes;
  }
}

/** A file that the server sends as a whole, from the first byte to the last. */
class WholeFile {
  /**
   * @param {Response} response
   * @param {number} stallMs
   * @param {(count: number) => void} report
   */
  constructor(response, stallMs, report) {
    const length = Number(response.headers.get("Content-Length") ?? 0);
    if (length > WHOLE_FILE_LIMIT) {
      const fix = "use a server that supports range requests";
      throw new SceneError(`${response.url}: expected at most ${WHOLE_FILE_LIMIT} bytes, got ${length}; ${fix}`);
    }
    this.bytes = new Uint8Array(Math.max(length, 1 << 20));
    this.count = 0;
    this.done = false;
    /** @type {unknown} */
    this.error = null;
    /** @type {Set<() => void>} */
    this.waiting = new Set();
    /** Resolves when no more data will arrive. */
    this.end = this.#receive(response, stallMs, report);
  }

  /**
   * @param {number} offset
   * @param {number} size
   * @returns {Promise<Uint8Array>}
   */
  async read(offset, size) {
    while (!this.done && this.count < offset + size) {
      await new Promise((resolve) => this.waiting.add(() => resolve(undefined)));
    }
    if (this.error && this.count < offset + size) throw this.error;
    return this.bytes.slice(Math.min(offset, this.count), Math.min(offset + size, this.count));
  }

  /**
   * @param {Response} response
   * @param {number} stallMs
   * @param {(count: number) => void} report
   */
  async #receive(response, stallMs, report) {
    const reader = response.body?.getReader();
    try {
      while (reader) {
        const { done, value } = await within(reader.read(), stallMs);
        if (done) break;
        this.#append(value);
        report(value.length);
      }
    } catch (error) {
      this.error = error;
      reader?.cancel().catch(() => {});
    }
    this.done = true;
    this.#wake();
  }

  /** @param {Uint8Array} chunk */
  #append(chunk) {
    const needed = this.count + chunk.length;
    if (needed > WHOLE_FILE_LIMIT) throw new SceneError("The file is too large for a server without range requests");
    if (needed > this.bytes.length) {
      const larger = new Uint8Array(Math.min(Math.max(needed, 2 * this.bytes.length), WHOLE_FILE_LIMIT));
      larger.set(this.bytes.subarray(0, this.count));
      this.bytes = larger;
    }
    this.bytes.set(chunk, this.count);
    this.count = needed;
    this.#wake();
  }

  #wake() {
    const waiting = [...this.waiting];
    this.waiting.clear();
    for (const resume of waiting) resume();
  }
}

/** Aborts a request if no data arrives for some time, or if the caller aborts it. */
class Stall {
  /**
   * @param {number} ms
   * @param {AbortSignal} [signal]
   */
  constructor(ms, signal) {
    this.ms = ms;
    this.outer = signal;
    this.controller = new AbortController();
    this.forward = () => this.controller.abort();
    if (signal?.aborted) this.controller.abort();
    signal?.addEventListener("abort", this.forward);
    this.reset();
  }

  get signal() {
    return this.controller.signal;
  }

  reset() {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.controller.abort(new Error("the server sends no data")), this.ms);
  }

  release() {
    clearTimeout(this.timer);
    this.outer?.removeEventListener("abort", this.forward);
  }
}

/**
 * @param {Response} response
 * @returns {AsyncGenerator<Uint8Array>}
 */
async function* chunks(response) {
  const reader = response.body?.getReader();
  while (reader) {
    const { done, value } = await reader.read();
    if (done) return;
    yield value;
  }
}

/**
 * @template T
 * @param {Promise<T>} promise
 * @param {number} ms
 * @returns {Promise<T>}
 */
function within(promise, ms) {
  return new Promise((resolve, reject) => {
    const timer = setTimeout(() => reject(new Error("the server sends no data")), ms);
    promise.then(resolve, reject).finally(() => clearTimeout(timer));
  });
}

/** @param {Response} response */
function tagOf(response) {
  return response.headers.get("ETag") ?? response.headers.get("Last-Modified");
}

/** @param {number} ms */
function sleep(ms) {
  return new Promise((resolve) => setTimeout(resolve, ms));
}

/** @param {unknown} error */
function networkProblem(error) {
  const text = error instanceof Error ? error.message : String(error);
  return text === "Failed to fetch" || text.startsWith("NetworkError") ? "the server does not answer" : text;
}
