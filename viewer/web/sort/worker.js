import { DepthOrder } from "./depth_order.js";
/** @typedef {import("./sorter.js").SortRequest} SortRequest */

/** @type {{postMessage(message: import("./sorter.js").SortReply, transfer: Transferable[]): void, onmessage: unknown}} */
const scope = /** @type {any} */ (self);
const order = new DepthOrder();
/** @type {Map<number, Float32Array>} */
const clouds = new Map();

scope.onmessage = (/** @type {MessageEvent<SortRequest>} */ event) => {
  const { clouds: wanted, camera, uploads } = event.data;
  const started = performance.now();
  for (const { cloud, xyz } of uploads) clouds.set(cloud, xyz);
  for (const cloud of [...clouds.keys()]) {
    if (!wanted.some((item) => item.cloud === cloud)) clouds.delete(cloud);
  }
  const positions = wanted.map((item) => ({ ...item, xyz: clouds.get(item.cloud) ?? new Float32Array(0) }));
  const sorted = order.sort(positions, camera);
  scope.postMessage({ ...sorted, ms: performance.now() - started }, [sorted.points.buffer]);
};
