import { defaultSettings } from "@playcanvas/supersplat-viewer/settings";
import { createViewer } from "@playcanvas/supersplat-viewer/viewer";
import { Mat4 } from "playcanvas";

const size = Number(new URLSearchParams(location.search).get("size"));

async function start() {
  // The canvas must keep its content, because images are read from it after they are shown.
  const { getContext } = HTMLCanvasElement.prototype;
  HTMLCanvasElement.prototype.getContext = function (kind, options) {
    return getContext.call(this, kind, { ...options, preserveDrawingBuffer: true });
  };
  const container = document.createElement("div");
  Object.assign(container.style, { width: `${size}px`, height: `${size}px`, position: "relative" });
  document.body.append(container);
  const settings = { ...defaultSettings(), background: { color: [0, 0, 0] } };
  const options = { container, settings, contentUrl: "frame.ply", renderer: "webgl", ui: false, noanim: true, nofx: true };
  const viewer = await createViewer(options);
  if (!viewer.state.loaded) await new Promise((resolve) => viewer.events.once("loaded:changed", resolve));
  return { draw: drawing(viewer.app), canvas: container.querySelector("canvas") };
}

/** Stops the viewer's own drawing loop, and returns a function that draws one image with the viewer's renderer. */
function drawing(app) {
  cancelAnimationFrame(app.frameRequestId);
  const { camera } = app.root.findComponent("camera").entity;
  // The viewer rotates the loaded splats by 180 degrees.
  const turn = app.root.findComponent("gsplat").entity.getWorldTransform();
  const pose = new Mat4();
  let projection;
  camera.calculateProjection = (matrix) => matrix.data.set(projection);
  return (matrices) => {
    pose.data.set(matrices.view);
    pose.invert().mul2(turn, pose);
    projection = matrices.projection;
    app.update(0);
    camera.entity.setPosition(pose.getTranslation());
    camera.entity.setEulerAngles(pose.getEulerAngles());
    app.fire("framerender");
    app.render();
    app.fire("frameend");
  };
}

/** The interface that tools/measurements/web/loop.js uses. */
window.viewer = start();
