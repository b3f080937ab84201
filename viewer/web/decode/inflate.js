import { SceneError } from "../scene/errors.js";
import { largestContent } from "../scene/limits.js";

const ZSTD_MAGIC = 0xfd2fb528;

/**
 * Decompresses a member. Fails if the result has more than `largest` bytes.
 * @param {Uint8Array} member
 * @param {number} largest
 * @param {string} name Name of the member, for error messages.
 * @returns {Promise<Uint8Array>}
 */
export async function inflate(member, largest, name) {
  if (member.length >= 4 && new DataView(member.buffer, member.byteOffset).getUint32(0, true) === ZSTD_MAGIC) {
    throw new SceneError(`${name}: expected zlib, got Zstandard, which browsers cannot decompress; use fourd web`);
  }
  if (largest > largestContent(member.length)) {
    throw damaged(name, `${largest} bytes`, `${member.length} compressed bytes, which cannot contain them`);
  }
  const stream = new DecompressionStream("deflate");
  const writer = stream.writable.getWriter();
  // Errors of the writer can be ignored, because reading fails whenever writing to the stream fails.
  writer.write(/** @type {Uint8Array<ArrayBuffer>} */ (member)).catch(() => {});
  writer.close().catch(() => {});
  const reader = stream.readable.getReader();
  const content = new Uint8Array(largest);
  let count = 0;
  for (;;) {
    const { done, value } = await reader.read().catch((error) => {
      throw damaged(name, "zlib data", error instanceof Error ? error.message : String(error));
    });
    if (done) return content.subarray(0, count);
    if (count + value.length > largest) {
      reader.cancel().catch(() => {});
      throw damaged(name, `at most ${largest} bytes`, "more");
    }
    content.set(value, count);
    count += value.length;
  }
}

/**
 * @param {Uint8Array} member
 * @param {number} size
 * @param {string} name
 * @returns {Promise<Uint8Array>}
 */
export async function inflateExactly(member, size, name) {
  const content = await inflate(member, size, name);
  if (content.length !== size) throw damaged(name, `${size} bytes`, `${content.length}`);
  return content;
}

/**
 * @param {string} name
 * @param {string} expected
 * @param {string} got
 */
export function damaged(name, expected, got) {
  return new SceneError(`${name}: expected ${expected}, got ${got}; the scene is damaged: copy or export it again`);
}
