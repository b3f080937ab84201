/** Reads a scene from memory with the modules of the web player, without a browser. */

import { decodeBase, decodeView } from "../../../../viewer/web/decode/cloud.js";
import { inflateExactly } from "../../../../viewer/web/decode/inflate.js";
import { selectSourceViews } from "../../../../viewer/web/navigate/source_views.js";
import { SceneError } from "../../../../viewer/web/scene/errors.js";
import { SceneFile } from "../../../../viewer/web/scene/scene_file.js";
import { DepthOrder } from "../../../../viewer/web/sort/depth_order.js";

const MAX_FRAMES = 4;
const MAX_VIEWS = 8;

/** A file in memory with the interface of ByteSource. */
class MemorySource {
  constructor(bytes) {
    this.bytes = bytes;
    this.url = "scene.4dv";
    this.size = bytes.length;
  }

  async read(offset, size) {
    return this.bytes.slice(Math.min(offset, this.size), Math.min(offset + size, this.size));
  }

  async readExactly(offset, size) {
    const bytes = await this.read(offset, size);
    if (bytes.length !== size) throw new SceneError(`${this.url}: expected more bytes; copy the file again`);
    return bytes;
  }
}

/** Decodes the first frames with their source views, the background and the shadows, and sorts the points. */
export async function readScene(bytes) {
  const file = await SceneFile.open(new MemorySource(bytes));
  const { manifest } = file;
  const clouds = [];
  if (manifest.background) {
    clouds.push(await readCloud(file, "background", manifest.background.points, manifest.backgroundEncoding));
  }
  for (let frame = 0; frame < Math.min(manifest.points.length, MAX_FRAMES); frame++) {
    const folder = `frames/${String(frame).padStart(6, "0")}`;
    clouds.push(await readCloud(file, folder, manifest.points[frame], manifest.dynamicEncoding));
    if (manifest.background?.shadow) {
      const member = (await file.read([`${folder}/shadow`])).get(`${folder}/shadow`);
      await inflateExactly(member, manifest.background.points, `${folder}/shadow`);
    }
  }
  for (const camera of manifest.cameras.slice(0, 2)) sortPoints(clouds, camera, manifest);
}

async function readCloud(file, folder, points, encoding) {
  const { sources } = file.manifest;
  const names = [`${folder}/points`, `${folder}/sh`];
  if (sources.length) names.push(`${folder}/colour`);
  const found = await file.read(names);
  const members = { points: found.get(names[0]), sh: found.get(names[1]), colour: found.get(names[2]) ?? null };
  const base = await decodeBase(members, points, encoding, folder);
  check(base.xyz.length === 3 * points && base.sizes.length === points && base.mean.length === 4 * points, "sizes");
  check(base.factors.length === encoding.shRows * points, "factors");
  if (file.manifest.hasNormals) {
    const name = `${folder}/optional/normals`;
    check((await inflateExactly((await file.read([name])).get(name), 2 * points, name)).length === 2 * points, "normals");
  }
  check(base.largestRadius >= 0 && Number.isFinite(base.largestRadius), "largest radius");
  check(base.xyz.every(Number.isFinite), "positions");
  for (let view = 0; view < Math.min(sources.length, MAX_VIEWS); view++) {
    const name = `${folder}/views/${String(view).padStart(3, "0")}`;
    const rgba = await decodeView((await file.read([name])).get(name), base.mean, encoding, name);
    check(rgba.length === 4 * points, "colours");
  }
  return base;
}

function sortPoints(clouds, camera, manifest) {
  const { views, weights } = selectSourceViews(camera, manifest);
  check(views.length === weights.length && weights.every(Number.isFinite), "view weights");
  let first = 0;
  const listed = clouds.map(({ xyz, largestRadius, points }) => {
    first += points;
    return { xyz, first: first - points, radius: largestRadius };
  });
  const sorted = new DepthOrder().sort(listed, { ...camera, near: manifest.near, border: camera.width });
  check(sorted.points.every((index) => index < first), "indices");
  check(!Number.isNaN(sorted.ratio), "ratio");
}

function check(isRight, what) {
  if (!isRight) throw new Error(`the reader accepts a scene whose ${what} are wrong`);
}
