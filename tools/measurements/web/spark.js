import { SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
import * as THREE from "three";

const size = Number(new URLSearchParams(location.search).get("size"));
const renderer = new THREE.WebGLRenderer({ antialias: false, preserveDrawingBuffer: true });
renderer.setSize(size, size, false);
document.body.append(renderer.domElement);
const scene = new THREE.Scene();
const camera = new THREE.PerspectiveCamera();
camera.matrixWorldAutoUpdate = false;
scene.add(new SparkRenderer({ renderer }));

/** Draws an image. @param {{view: number[], projection: number[]}} matrices Column-major. */
function draw({ view, projection }) {
  camera.matrixWorldInverse.fromArray(view);
  camera.matrixWorld.copy(camera.matrixWorldInverse).invert();
  camera.projectionMatrix.fromArray(projection);
  camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
  renderer.render(scene, camera);
}

async function start() {
  const splats = new SplatMesh({ url: "frame.ply" });
  await splats.initialized;
  scene.add(splats);
  return { draw, canvas: renderer.domElement };
}

/** The interface that tools/measurements/web/loop.js uses. */
window.viewer = start();
