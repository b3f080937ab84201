import { SceneError } from "../scene/errors.js";
import { LineRate } from "../scene/line_rate.js";

/** Time in milliseconds without an answer of the kernel after which the page says so. */
const SILENCE_MS = 10000;
/** Largest range of a message, so that other messages need not wait long. */
const MAX_RANGE = 1 << 19;
/** Maximum number of messages without an answer. The kernel answers in order, and does not know that the page no longer needs
 * a range. With more messages, ranges that are needed now would wait for many that are not. */
const MAX_SENT = 4;

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
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.timer = undefined;
    /** Requests without an answer that the page still needs. @type {Map<string, Waiting>} */
    this.waiting = new Map();
    /** Messages that are not sent yet. @type {{id: string, offset: number, size: number}[]} */
    this.queue = [];
    /** Numbers of the messages without an answer. @type {Set<string>} */
    this.sent = new Set();
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
    await Promise.all(
      starts.map(async (start) => {
        bytes.set(await this.request(start, Math.min(MAX_RANGE, end - start), signal), start - offset);
      }),
    );
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
        this.queue = this.queue.filter((message) => message.id !== id);
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
      this.queue.push({ id, offset, size });
      this.send();
    });
  }

  /** Sends messages while few are without an answer. */
  send() {
    while (this.sent.size < MAX_SENT) {
      const message = this.queue.shift();
      if (!message) return;
      this.sent.add(message.id);
      this.rate.begin();
      this.model.send(message);
      this.timer ??= setTimeout(this.silent, SILENCE_MS);
    }
  }

  /**
   * @param {{id?: string, error?: string}} content
   * @param {(DataView | ArrayBuffer)[]} buffers
   */
  receive(content, buffers) {
    const id = content?.id ?? "";
    if (!this.sent.delete(id)) return;
    clearTimeout(this.timer);
    this.timer = undefined;
    const bytes = content.error === undefined ? toBytes(buffers[0]) : new Uint8Array(0);
    this.rate.receive(bytes.length);
    this.rate.end();
    const waiting = this.waiting.get(id);
    this.waiting.delete(id);
    if (content.error === undefined) waiting?.resolve(bytes);
    else waiting?.reject(new SceneError(content.error));
    this.send();
  }

  release() {
    clearTimeout(this.timer);
    this.queue = [];
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
