import { SceneError } from "../scene/errors.js";
import { LineRate } from "../scene/line_rate.js";

/** Time in milliseconds without an answer of the kernel after which the user is told. */
const SILENCE_MS = 10000;
/** Largest range that the kernel is asked for at once, so that other messages need not wait long. */
const MAX_RANGE = 1 << 20;

/**
 * A widget's model, as notebooks implement it.
 * @typedef {object} Model
 * @property {(name: string) => any} get
 * @property {(name: string, listener: (...values: any[]) => void) => void} on
 * @property {(name: string, listener: (...values: any[]) => void) => void} off
 * @property {(content: any) => void} send
 */

/** @typedef {{resolve: (bytes: Uint8Array) => void, reject: (error: Error) => void}} Waiting */

/** What both sources have in common. */
class Source {
  /**
   * @param {string} url Name of the scene in messages.
   * @param {number} size Size of the scene in bytes.
   */
  constructor(url, size) {
    this.url = url;
    this.size = size;
  }

  /**
   * @param {number} offset
   * @param {number} size
   * @param {AbortSignal} [_signal]
   * @returns {Promise<Uint8Array>} The bytes of the range, or fewer if the scene ends inside the range.
   */
  async read(offset, size, _signal) {
    throw new Error(`no bytes ${offset} to ${offset + size}`);
  }

  /**
   * @param {number} offset
   * @param {number} size
   * @param {AbortSignal} [signal]
   */
  async readExactly(offset, size, signal) {
    const bytes = await this.read(offset, size, signal);
    if (bytes.length !== size) {
      const end = offset + bytes.length;
      throw new SceneError(`${this.url}: expected at least ${offset + size} bytes, got ${end}; call fourd.show again`);
    }
    return bytes;
  }

  async hasChanged() {
    return false;
  }
}

/** Reads byte ranges of a scene from the kernel, with messages of the widget. */
export class KernelSource extends Source {
  /**
   * @param {Model} model
   * @param {string} url Name of the scene in messages.
   * @param {number} size Size of the scene in bytes.
   * @param {() => void} silent Called when the kernel does not answer for some seconds.
   */
  constructor(model, url, size, silent) {
    super(url, size);
    this.model = model;
    this.silent = silent;
    this.rate = new LineRate();
    /** Views of the same widget share its messages, so that each needs numbers of its own. */
    this.prefix = Math.random().toString(36).slice(2);
    this.next = 0;
    /** @type {Map<string, Waiting>} */
    this.waiting = new Map();
    this.receive = this.receive.bind(this);
    model.on("msg:custom", this.receive);
  }

  /**
   * @param {number} offset
   * @param {number} size
   * @param {AbortSignal} [signal]
   * @returns {Promise<Uint8Array>}
   */
  async read(offset, size, signal) {
    const end = Math.min(offset + size, this.size);
    const starts = [];
    for (let start = offset; start < end; start += MAX_RANGE) starts.push(start);
    const bytes = new Uint8Array(Math.max(end - offset, 0));
    this.rate.begin();
    try {
      await Promise.all(
        starts.map(async (start) => {
          const part = await this.request(start, Math.min(MAX_RANGE, end - start), signal);
          this.rate.receive(part.length);
          bytes.set(part, start - offset);
        }),
      );
    } finally {
      this.rate.end();
    }
    return bytes;
  }

  /**
   * @param {number} offset
   * @param {number} size
   * @param {AbortSignal} [signal]
   * @returns {Promise<Uint8Array>}
   */
  request(offset, size, signal) {
    const id = `${this.prefix}-${this.next++}`;
    return new Promise((resolve, reject) => {
      const stop = () => {
        this.waiting.delete(id);
        reject(new DOMException("The range is no longer needed", "AbortError"));
      };
      if (signal?.aborted) return stop();
      signal?.addEventListener("abort", stop, { once: true });
      const end = () => signal?.removeEventListener("abort", stop);
      this.waiting.set(id, {
        resolve: (bytes) => {
          end();
          if (bytes.length === size) resolve(bytes);
          else reject(new SceneError(`${this.url}: expected ${size} bytes, got ${bytes.length}; call fourd.show again`));
        },
        reject: (error) => {
          end();
          reject(error);
        },
      });
      this.model.send({ id, offset, size });
      this.timer ??= setTimeout(this.silent, SILENCE_MS);
    });
  }

  /**
   * @param {{id?: string, error?: string}} content
   * @param {(DataView | ArrayBuffer)[]} buffers
   */
  receive(content, buffers) {
    const waiting = this.waiting.get(content?.id ?? "");
    if (!waiting) return;
    clearTimeout(this.timer);
    this.timer = undefined;
    this.waiting.delete(content.id ?? "");
    if (content.error !== undefined) waiting.reject(new SceneError(content.error));
    else waiting.resolve(toBytes(buffers[0]));
  }

  release() {
    clearTimeout(this.timer);
    this.model.off("msg:custom", this.receive);
    for (const { reject } of this.waiting.values()) reject(new SceneError("The player was closed"));
    this.waiting.clear();
  }
}

/** Reads byte ranges of a scene that is a part of the widget, so that it plays without a kernel. */
export class EmbeddedSource extends Source {
  /**
   * @param {Uint8Array} bytes
   * @param {string} url Name of the scene in messages.
   */
  constructor(bytes, url) {
    super(url, bytes.length);
    this.bytes = bytes;
    this.rate = { bytesPerSecond: Infinity };
  }

  /**
   * @param {number} offset
   * @param {number} size
   */
  async read(offset, size) {
    return this.bytes.slice(offset, offset + size);
  }

  release() {}
}

/** @param {DataView | ArrayBuffer | ArrayBufferView} buffer A buffer of a message or of a trait. */
export function toBytes(buffer) {
  return ArrayBuffer.isView(buffer)
    ? new Uint8Array(buffer.buffer, buffer.byteOffset, buffer.byteLength)
    : new Uint8Array(buffer);
}
