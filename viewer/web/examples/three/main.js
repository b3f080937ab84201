import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { FourdScene } from "../../fourd-scene.js";
import { DepthCopy } from "./depth_copy.js";

const message = /** @type {HTMLElement} */ (document.getElementById("message"));
const canvas = /** @type {HTMLCanvasElement} */ (document.querySelector("canvas"));
const renderer = new THREE.WebGLRenderer({ canvas, antialias: false });
const gl = /** @type {WebGL2RenderingContext} */ (renderer.getContext());
const camera = new THREE.PerspectiveCamera(40, 1, 0.05, 100);
const controls = new OrbitControls(camera, canvas);
/** Objects that three.js draws before the points, and that hide the points behind them. */
const opaque = new THREE.Scene();
/** Objects that three.js draws after the points, and that are hidden by the points in front of them. */
const transparent = new THREE.Scene();
/** Colour and depth of the opaque objects. */
const target = new THREE.WebGLRenderTarget(1, 1, { samples: 4, depthTexture: new THREE.DepthTexture(1, 1) });
const copy = new DepthCopy(target);
/** @type {FourdScene | null} */
let points = null;
let last = performance.now();

function addObjects() {
  opaque.background = new THREE.Color(0x30343c);
  opaque.add(new THREE.HemisphereLight(0xffffff, 0x445566, 3));
  const ring = new THREE.Mesh(
    new THREE.TorusGeometry(0.62, 0.05, 24, 96),
    new THREE.MeshStandardMaterial({ color: 0xe08020, roughness: 0.4 }),
  );
  ring.rotation.x = 1.2;
  const floor = new THREE.GridHelper(4, 20, 0x8090a0, 0x505860);
  floor.position.y = -0.75;
  opaque.add(ring, floor);
  const glass = new THREE.Mesh(
    new THREE.PlaneGeometry(1.6, 1),
    new THREE.MeshBasicMaterial({ color: 0x40c0ff, transparent: true, opacity: 0.35, side: THREE.DoubleSide }),
  );
  glass.rotation.y = 0.9;
  transparent.add(glass);
}

/** Returns the view from which the points are drawn, which consists of three.js' matrices and the viewport. */
function view() {
  const { width, height } = canvas;
  const viewport = /** @type {[number, number, number, number]} */ ([0, 0, width, height]);
  return { viewMatrix: camera.matrixWorldInverse.elements, projectionMatrix: camera.projectionMatrix.elements, viewport };
}

function resize() {
  const { clientWidth, clientHeight } = canvas;
  renderer.setPixelRatio(devicePixelRatio);
  renderer.setSize(clientWidth, clientHeight, false);
  target.setSize(canvas.width, canvas.height);
  camera.aspect = clientWidth / clientHeight;
  camera.updateProjectionMatrix();
}

function draw() {
  renderer.setRenderTarget(target);
  renderer.render(opaque, camera);
  renderer.setRenderTarget(null);
  copy.draw(renderer);
  if (points) {
    const depthTexture = renderer.properties.get(target.depthTexture).__webglTexture;
    points.draw(view(), { depthTexture, writesDepth: true });
    renderer.resetState();
  }
  renderer.autoClear = false;
  renderer.render(transparent, camera);
  renderer.autoClear = true;
}

/** @param {number} now */
function step(now) {
  controls.update();
  camera.updateMatrixWorld();
  points?.update(Math.max(now - last, 0) / 1000, view());
  last = now;
  draw();
}

async function start() {
  addObjects();
  camera.position.set(0.7, 0.5, 2.6);
  resize();
  addEventListener("resize", resize);
  const url = new URLSearchParams(location.search).get("scene") ?? "scene.4dv";
  points = await FourdScene.open(gl, url, (error) => (message.textContent = String(error)));
  points.placeUpright(2.6);
  points.clock.isPlaying = true;
  renderer.resetState();
  renderer.setAnimationLoop(step);
  return { THREE, renderer, camera, opaque, transparent, points, draw, view, gl };
}

/** The parts of the page, exported for tests that control it. */
export const example = start().catch((error) => {
  message.textContent = String(error);
  throw error;
});
