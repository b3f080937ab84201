import { SceneError } from "./errors.js";
import { parseManifest } from "./manifest.js";
import { missingDecoder } from "./support.js";
/** @typedef {import("./manifest.js").Manifest} Manifest */

/**
 * Where the bytes of a scene come from, such as a `ByteSource` or the kernel of a notebook.
 * @typedef {Pick<import("./byte_source.js").ByteSource, "url" | "size" | "read" | "readExactly" | "hasChanged">
 *   & {rate: {bytesPerSecond: number | null}}} Source
 */

const FIRST_READ = 1 << 16;
const LOCAL_HEADER = 30;
const MAX_MANIFEST = 64 << 20;
/** Members that are at most this number of bytes apart are read with one request, which is faster than two. */
const MERGE_GAP = 1 << 15;

/** A packed scene. */
export class SceneFile {
  /**
   * @param {Source} source
   * @param {Manifest} manifest
   */
  constructor(source, manifest) {
    this.source = source;
    this.manifest = manifest;
  }

  /**
   * Reads the manifest, which is the first member of the file.
   * @param {Source} source
   * @returns {Promise<SceneFile>}
   */
  static async open(source) {
    const head = await source.read(0, FIRST_READ);
    const { start, size } = manifestRange(head, source.url);
    const rest = Math.max(start + size - head.length, 0);
    const tail = rest > 0 ? await source.readExactly(head.length, rest) : new Uint8Array(0);
    const bytes = new Uint8Array(size);
    bytes.set(head.subarray(start, start + size));
    bytes.set(tail, size - rest);
    const manifest = parseManifest(new TextDecoder().decode(bytes));
    checkRanges(manifest, source);
    const missing = manifest.dynamicEncoding.imageScale === null ? null : missingDecoder();
    if (missing) throw new SceneError(missing);
    return new SceneFile(source, manifest);
  }

  /**
   * Reads members. Members that are close together in the file are read with one request.
   * @param {string[]} names
   * @param {AbortSignal} [signal]
   * @returns {Promise<Map<string, Uint8Array>>} Compressed content by name.
   */
  async read(names, signal) {
    const wanted = names.map((name) => ({ name, ...this.#range(name) })).sort((a, b) => a.offset - b.offset);
    /** @type {{offset: number, end: number, members: typeof wanted}[]} */
    const runs = [];
    for (const member of wanted) {
      const last = runs.at(-1);
      if (last && member.offset >= last.offset && member.offset - last.end <= MERGE_GAP) {
        last.end = Math.max(last.end, member.offset + member.size);
        last.members.push(member);
      } else {
        runs.push({ offset: member.offset, end: member.offset + member.size, members: [member] });
      }
    }
    const found = new Map();
    await Promise.all(
      runs.map(async (run) => {
        const bytes = await this.source.readExactly(run.offset, run.end - run.offset, signal);
        for (const { name, offset, size } of run.members) {
          found.set(name, bytes.slice(offset - run.offset, offset - run.offset + size));
        }
      }),
    );
    return found;
  }

  /**
   * Returns the compressed size of a member in bytes.
   * @param {string} name
   */
  sizeOf(name) {
    return this.#range(name).size;
  }

  /** @param {string} name */
  #range(name) {
    const range = this.manifest.members.get(name);
    if (!range) throw new SceneError(`${this.source.url}: expected the member ${name}, got none; export the scene again`);
    return { offset: range[0], size: range[1] };
  }
}

/**
 * If the server has sent the size of the file, checks that all members end inside the file.
 * @param {Manifest} manifest
 * @param {Source} source
 */
function checkRanges({ members }, { size: total, url }) {
  if (total === null) return;
  for (const [offset, size] of members.values()) {
    if (offset + size > total) {
      throw new SceneError(`${url}: expected at least ${offset + size} bytes, got ${total}; copy the file again`);
    }
  }
}

/**
 * @param {Uint8Array} head First bytes of the file.
 * @param {string} url
 */
function manifestRange(head, url) {
  const view = new DataView(head.buffer, head.byteOffset, head.byteLength);
  const expected = `${url}: expected a packed .4dv scene`;
  if (head.length < LOCAL_HEADER || view.getUint32(0, true) !== 0x04034b50) {
    throw new SceneError(`${expected}, got another kind of file; write the site again with fourd web`);
  }
  const nameLength = view.getUint16(26, true);
  const start = LOCAL_HEADER + nameLength + view.getUint16(28, true);
  const name = new TextDecoder().decode(head.subarray(LOCAL_HEADER, LOCAL_HEADER + nameLength));
  const size = view.getUint32(22, true);
  if (name !== "manifest.json") throw new SceneError(`${expected}, got a file without index; use fourd web`);
  if (size > MAX_MANIFEST || view.getUint32(18, true) !== size) {
    throw new SceneError(`${expected}, got a manifest of ${size} bytes; copy the file again`);
  }
  return { start, size };
}
