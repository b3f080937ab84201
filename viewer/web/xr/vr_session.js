import { HostRenderer } from "../draw/host_renderer.js";
import { hostCamera, multiply4 } from "../navigate/host_camera.js";
import { row } from "../navigate/math.js";
import { uprightMatrix } from "../navigate/placement.js";
import { dolly, eyeOf, orbit } from "../navigate/pose.js";
import { selectSourceViews } from "../navigate/source_views.js";
/** @typedef {import("../play/stage.js").Stage} Stage */

/**
 * The parts of WebXR that the player uses.
 * @typedef {{matrix: Float32Array, inverse: Transform}} Transform
 * @typedef {{x: number, y: number, width: number, height: number}} Viewport
 * @typedef {{projectionMatrix: Float32Array, transform: Transform}} EyeView
 * @typedef {{views: EyeView[], transform: Transform}} ViewerPose
 * @typedef {{framebuffer: WebGLFramebuffer | null, framebufferWidth: number, framebufferHeight: number,
 *   getViewport(view: EyeView): Viewport | null}} Layer
 * @typedef {{getViewerPose(space: unknown): ViewerPose | null}} XrFrame
 * @typedef {EventTarget & {inputSources: Iterable<{gamepad?: Gamepad | null}>, renderState: {baseLayer: Layer | null},
 *   end(): Promise<void>, requestReferenceSpace(type: string): Promise<unknown>,
 *   updateRenderState(state: {baseLayer: Layer}): void,
 *   requestAnimationFrame(callback: (time: number, frame: XrFrame) => void): number}} Session
 * @typedef {{isSessionSupported(mode: string): Promise<boolean>, requestSession(mode: string): Promise<Session>}} XrSystem
 */

const MODE = "immersive-vr";
/** Initial distance in metres from the viewer to the pivot of the view. */
const PIVOT_DISTANCE = 1.5;
const TURN_PER_SECOND = Math.PI / 2;
/** A fully deflected thumbstick multiplies the distance to the pivot by this factor per second. */
const DOLLY_PER_SECOND = 2;
/** A thumbstick is ignored if its deflection, from 0 to 1, is not larger than this value. */
const DEAD_ZONE = 0.15;

/** Returns true if the browser and a connected headset can show virtual reality. */
export async function supportsVr() {
  try {
    return (await xrSystem()?.isSessionSupported(MODE)) ?? false;
  } catch {
    return false; // A page in a frame without the permission "xr-spatial-tracking" cannot use WebXR.
  }
}

/**
 * Shows a stage in a headset. The viewer starts at the eye of the page's view, and the scene is scaled so that the
 * pivot of the view is 1.5 m away. The trigger starts and pauses playback. The thumbsticks orbit the pivot and move the
 * viewer nearer or farther.
 */
export class VrSession {
  /**
   * Starts a session. Browsers allow the start only while they handle a click.
   * @param {Stage} stage It does not draw into its canvas until the session ends.
   * @param {(error: unknown) => void} ended Called when the session has ended, with an error or null.
   * @returns {Promise<VrSession>} Rejected if the browser refuses the session.
   */
  static async start(stage, ended) {
    const session = await /** @type {XrSystem} */ (xrSystem()).requestSession(MODE);
    try {
      const gl = /** @type {any} */ (stage.renderer?.gl);
      await gl.makeXRCompatible();
      const options = { alpha: false, antialias: false, depth: false, stencil: false };
      const layer = new /** @type {any} */ (globalThis).XRWebGLLayer(session, gl, options);
      session.updateRenderState({ baseLayer: layer });
      return new VrSession(session, await session.requestReferenceSpace("local"), stage, ended);
    } catch (error) {
      session.end().catch(() => {});
      throw error;
    }
  }

  /**
   * @param {Session} session
   * @param {unknown} space
   * @param {Stage} stage
   * @param {(error: unknown) => void} ended
   */
  constructor(session, space, stage, ended) {
    const canvasRenderer = /** @type {import("../draw/renderer.js").CanvasRenderer} */ (stage.renderer);
    this.session = session;
    this.space = space;
    this.stage = stage;
    this.gl = canvasRenderer.gl;
    this.renderer = new HostRenderer(this.gl, stage.manifest, canvasRenderer.points);
    this.scale = PIVOT_DISTANCE / stage.pose.distance;
    this.last = 0;
    this.images = 0;
    this.isEnding = false;
    /** @type {unknown} */
    this.error = null;
    stage.isSuspended = true;
    session.addEventListener("select", () => stage.clock.toggle());
    session.addEventListener("end", () => {
      this.renderer.release();
      stage.isSuspended = false;
      stage.setPose(stage.pose);
      ended(this.error);
    });
    session.requestAnimationFrame((time, frame) => this.#step(time, frame));
  }

  end() {
    this.isEnding = true;
    this.session.end().catch(() => {}); // Ignore errors, because the session may have ended already.
  }

  /**
   * @param {number} time In milliseconds.
   * @param {XrFrame} frame
   */
  #step(time, frame) {
    if (this.isEnding) return;
    const elapsed = this.last ? Math.max(time - this.last, 0) / 1000 : 0;
    this.last = time;
    try {
      const layer = this.session.renderState.baseLayer;
      const viewer = frame.getViewerPose(this.space);
      if (layer && viewer && viewer.views.length) this.#draw(elapsed, layer, viewer);
    } catch (error) {
      this.error = error;
      this.end();
      return;
    }
    this.session.requestAnimationFrame((time, frame) => this.#step(time, frame));
  }

  /**
   * @param {number} elapsed
   * @param {Layer} layer
   * @param {ViewerPose} viewer
   */
  #draw(elapsed, layer, viewer) {
    const { stage, gl } = this;
    this.#readThumbsticks(elapsed);
    const { pose } = stage;
    const matrix = uprightMatrix(eyeOf(pose), pose.up, row(pose.rotation, 2), this.scale);
    const eyes = viewer.views.flatMap((view) => {
      const viewport = layer.getViewport(view);
      return viewport && viewport.width > 0 && viewport.height > 0 ? [{ view, viewport }] : [];
    });
    if (eyes.length === 0) return;
    // Both eyes use the depth order and the source views of the head's pose.
    const { view, viewport } = eyes[0];
    const headMatrix = multiply4(viewer.transform.inverse.matrix, matrix);
    const head = hostCamera(headMatrix, view.projectionMatrix, viewport.width, viewport.height).camera;
    stage.playback.update(elapsed, head);
    const selection = selectSourceViews(head, stage.manifest);
    this.#clear(layer);
    for (const { view, viewport } of eyes) {
      const modelView = multiply4(view.transform.inverse.matrix, matrix);
      const { camera, depthRange } = hostCamera(modelView, view.projectionMatrix, viewport.width, viewport.height);
      const picture = stage.playback.picture(camera, selection);
      const target = { framebuffer: layer.framebuffer, depthRange, depthTexture: null, writesDepth: false };
      if (picture) this.renderer.draw({ ...picture, layers: stage.layers }, { ...target, corner: [viewport.x, viewport.y] });
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
    this.images++;
  }

  /** @param {Layer} layer */
  #clear(layer) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
    gl.viewport(0, 0, layer.framebufferWidth, layer.framebufferHeight);
    gl.clearColor(...this.stage.background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
  }

  /** @param {number} elapsed */
  #readThumbsticks(elapsed) {
    for (const { gamepad } of this.session.inputSources) {
      const [x = 0, y = 0] = gamepad?.axes.slice(2, 4) ?? [];
      let { pose } = this.stage;
      if (Math.abs(x) > DEAD_ZONE) pose = orbit(pose, TURN_PER_SECOND * elapsed * x, 0);
      if (Math.abs(y) > DEAD_ZONE) pose = dolly(pose, DOLLY_PER_SECOND ** (elapsed * y));
      this.stage.pose = pose;
    }
  }
}

/** @returns {XrSystem | undefined} */
function xrSystem() {
  return /** @type {any} */ (navigator).xr;
}
