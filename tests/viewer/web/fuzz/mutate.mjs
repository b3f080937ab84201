/** Damages scenes at random. */

import { deflateSync, inflateSync } from "node:zlib";

const HEADER = 30;
/** Bytes of padding after the manifest, so that its text can grow without moving the members. */
const ROOM = 1 << 12;
const NUMBERS = [0, -1, 1, 2, 0.5, 3, 255, 256, 65535, 65536, 2 ** 24, 2 ** 31, 2 ** 32, 2 ** 53, 1e29, -1e29, 1e300, -1e-320];
const OTHERS = [null, true, false, "", "x", "\n\u0000", [], [[]], [1e9], {}, { a: { b: [] } }, "9".repeat(300)];
const KEYS = ["", "__proto__", "constructor", "frames/000000/points\n", "toString"];

/** Random numbers with a seed (Mulberry32, Tommy Ettinger 2017). */
export class Random {
  constructor(seed) {
    this.state = seed >>> 0;
  }

  /** A number in [0, 1). */
  next() {
    this.state = (this.state + 0x6d2b79f5) >>> 0;
    let t = Math.imul(this.state ^ (this.state >>> 15), 1 | this.state);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
  }

  below(count) {
    return Math.floor(this.next() * count);
  }

  pick(items) {
    return items[this.below(items.length)];
  }
}

/** Splits a scene into its manifest and the bytes after the manifest. */
export function splitScene(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset);
  const start = HEADER + view.getUint16(26, true) + view.getUint16(28, true);
  const size = view.getUint32(22, true);
  const manifest = JSON.parse(Buffer.from(bytes.subarray(start, start + size)).toString());
  for (const range of Object.values(manifest.members)) range[0] += ROOM;
  return { start, header: bytes.slice(0, start), size: size + ROOM, manifest, body: bytes.slice(start + size) };
}

/** Joins a manifest and the remaining bytes of a scene. The manifest can also be a text. */
export function joinScene({ start, header, size, body }, manifest) {
  const text = Buffer.from(typeof manifest === "string" ? manifest : JSON.stringify(manifest));
  const length = Math.max(size, text.length);
  const bytes = new Uint8Array(start + length + body.length).fill(32);
  bytes.set(header);
  const view = new DataView(bytes.buffer);
  view.setUint32(18, length, true);
  view.setUint32(22, length, true);
  bytes.set(text, start);
  bytes.set(body, start + length);
  return bytes;
}

/** A damaged scene. */
export function mutate(scene, random) {
  const manifest = structuredClone(scene.manifest);
  const kind = random.pick(["bytes", "bytes", "cut", "value", "value", "value", "range", "content", "content", "bomb", "text"]);
  if (kind === "value") for (let i = 1 + random.below(3); i > 0; i--) changeValue(manifest, random);
  if (kind === "range") changeRange(manifest, random, scene);
  if (kind === "content") return changeContent(scene, manifest, random);
  if (kind === "bomb") return appendMember(scene, manifest, random.pick(Object.keys(manifest.members)), random.pick(bombs()));
  const bytes = joinScene(scene, kind === "text" ? changeText(manifest, random) : manifest);
  if (kind === "bytes") changeBytes(bytes, random);
  return kind === "cut" ? bytes.slice(0, random.below(bytes.length)) : bytes;
}

function changeValue(root, random) {
  let node = root;
  for (;;) {
    const keys = Object.keys(node);
    if (keys.length === 0) return;
    const key = random.pick(keys);
    const child = node[key];
    const isBranch = typeof child === "object" && child !== null;
    if (isBranch && random.next() < 0.85) {
      node = child;
      continue;
    }
    const action = random.below(8);
    if (action === 0) delete node[key];
    else if (action === 1 && Array.isArray(node)) node.push(child);
    else if (action === 1) addKey(node, random.pick(KEYS), child);
    else if (action === 2 && typeof child === "number") node[key] = child + random.pick([-1, 1, 1e-9, 1e6]);
    else if (action < 6) node[key] = random.pick(NUMBERS);
    else node[key] = structuredClone(random.pick(OTHERS));
    return;
  }
}

/** Adds a key, even a key such as __proto__, which an assignment would not add. */
function addKey(node, key, child) {
  const options = { enumerable: true, writable: true, configurable: true };
  Object.defineProperty(node, key, { value: structuredClone(child), ...options });
}

function changeRange(manifest, random, scene) {
  const names = Object.keys(manifest.members);
  const range = manifest.members[random.pick(names)];
  const total = scene.start + scene.size + scene.body.length;
  if (random.next() < 0.3) manifest.members[random.pick(names)] = range;
  else range[random.below(2)] = random.pick([...NUMBERS, random.below(total), random.below(total), range[1] + 1, range[1] - 1]);
}

function changeText(manifest, random) {
  const text = JSON.stringify(manifest);
  const at = random.below(text.length);
  const parts = ["{", "[", '"', "\u0000", "\ud800", "1e999", "-", ",".repeat(50), "[".repeat(20000), text.slice(at)];
  return text.slice(0, at) + random.pick(parts) + text.slice(at + random.below(4));
}

function changeBytes(bytes, random) {
  if (random.next() < 0.2) {
    const first = random.below(bytes.length);
    bytes.copyWithin(first, random.below(bytes.length), random.below(bytes.length));
    return;
  }
  for (let i = 1 + random.below(16); i > 0; i--) {
    // Half of the changes are in the first 2000 bytes, where the header and the manifest are.
    const at = random.below(random.next() < 0.5 ? Math.min(2000, bytes.length) : bytes.length);
    bytes[at] = random.pick([0, 255, 127, bytes[at] ^ (1 << random.below(8)), random.below(256)]);
  }
}

/** Changes the content of a member and compresses it again, so that the checksum of the member is correct. */
function changeContent(scene, manifest, random) {
  const name = random.pick(Object.keys(manifest.members));
  const [offset, size] = manifest.members[name];
  const first = offset - scene.start - scene.size;
  let content = Buffer.from(inflateSync(scene.body.subarray(first, first + size)));
  const action = random.below(3);
  if (action === 0) content = content.subarray(0, random.below(content.length + 1));
  else if (action === 1) content = Buffer.concat([content, Buffer.alloc(1 + random.below(5000), random.below(256))]);
  else for (let i = 0; i < 20; i++) if (content.length) content[random.below(content.length)] = random.pick([0, 255, random.below(256)]);
  return appendMember(scene, manifest, name, deflateSync(content));
}

function appendMember(scene, manifest, name, member) {
  manifest.members[name] = [scene.start + scene.size + scene.body.length, member.length];
  const body = new Uint8Array(scene.body.length + member.length);
  body.set(scene.body);
  body.set(member, scene.body.length);
  return joinScene({ ...scene, body }, manifest);
}

let madeBombs = null;

/** Members that expand to much more than their declared size, and members that are truncated. */
function bombs() {
  const large = () => deflateSync(Buffer.alloc(1 << 26), { level: 9 });
  madeBombs ??= [large(), deflateSync(Buffer.alloc(1 << 20)), large().subarray(0, 30000), Buffer.alloc(0), Buffer.from([0x78])];
  return madeBombs;
}
