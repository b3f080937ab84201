import { describeError } from "../scene/errors.js";
import { decodeBase, decodeView } from "./cloud.js";
import { decodeImageViews } from "./images.js";
import { inflateExactly } from "./inflate.js";
/** @typedef {import("./pool.js").DecodeRequest} DecodeRequest */
/** @typedef {import("./pool.js").DecodeReply} DecodeReply */

/** @type {{postMessage(message: DecodeReply, transfer: Transferable[]): void, onmessage: unknown}} */
const scope = /** @type {any} */ (self);

scope.onmessage = async (/** @type {MessageEvent<DecodeRequest>} */ event) => {
  const { id } = event.data;
  const started = performance.now();
  try {
    const { result, transfer } = await decode(event.data);
    scope.postMessage({ id, result, ms: performance.now() - started }, transfer);
  } catch (error) {
    scope.postMessage({ id, error: describeError(error), ms: 0 }, []);
  }
};

/** @param {DecodeRequest} request */
async function decode(request) {
  if (request.kind === "base") {
    const base = await decodeBase(request.members, request.points, request.encoding, request.folder);
    const buffers = [base.xyz.buffer, base.sizes.buffer, base.factors.buffer, base.mean.buffer];
    return { result: base, transfer: buffers };
  }
  if (request.kind === "views") {
    const views = await decodeViews(request);
    return { result: views, transfer: views.map(([, rgba]) => rgba.buffer) };
  }
  const bytes = (await inflateExactly(request.member, request.size, request.name)).slice();
  return { result: bytes, transfer: [bytes.buffer] };
}

/**
 * @param {import("./pool.js").ViewsRequest} request
 * @returns {Promise<[number, Uint8Array<ArrayBuffer>][]>}
 */
async function decodeViews({ folder, encoding, mean, xyz, views }) {
  const nameOf = (/** @type {number} */ view) => `${folder}/views/${String(view).padStart(3, "0")}`;
  if (encoding.imageScale !== null && xyz) return decodeImageViews(views, { xyz, mean }, encoding.imageScale, nameOf);
  return Promise.all(
    views.map(async ({ view, member }) => {
      return /** @type {[number, Uint8Array<ArrayBuffer>]} */ ([view, await decodeView(member, mean, encoding, nameOf(view))]);
    }),
  );
}
