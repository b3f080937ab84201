import { DecodePool } from "./decode/pool.js";
import { setInitialState } from "./draw/gl.js";
import { HostRenderer } from "./draw/host_renderer.js";
import { ProjectedPoints } from "./draw/projected_points.js";
import { hostCamera, multiply4 } from "./navigate/host_camera.js";
import { addScaled, apply, length, transpose } from "./navigate/math.js";
import { uprightMatrix } from "./navigate/placement.js";
import { estimateUp } from "./navigate/pose.js";
import { selectSourceViews } from "./navigate/source_views.js";
import { Playback } from "./play/playback.js";
import { ByteSource } from "./scene/byte_source.js";
import { SceneError } from "./scene/errors.js";
import { SceneFile } from "./scene/scene_file.js";

const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

/**
 * An image to draw. Matrices are those of OpenGL, three.js and WebXR: 16 numbers, column-major.
 * @typedef {object} View
 * @property {ArrayLike<number>} viewMatrix Maps the host's world to camera coordinates (x right, y up, z backward).
 * @property {ArrayLike<number>} projectionMatrix A perspective projection that maps depths to the range from -1 to 1.
 * @property {[number, number, number, number]} viewport Corner (x, y) at the bottom left, width and height, in pixels.
 */

/**
 * A packed scene that is drawn into the WebGL 2 context of another program (the host), such as three.js.
 *
 * Once per displayed image, call `update` and then, after the host has drawn its opaque objects, `draw` for each view.
 * Both functions change the WebGL state. If the host caches this state, it must reset the cache afterwards (in
 * three.js, with `renderer.resetState()`).
 */
export class FourdScene {
  /**
   * Opens a scene.
   * @param {WebGL2RenderingContext} gl The context that the scene is drawn into.
   * @param {string} url Address of a scene that `fourd web` wrote.
   * @param {(error: unknown) => void} [failed] Called if loading or sorting fails later.
   * @returns {Promise<FourdScene>} Rejected with a SceneError if the scene cannot be read.
   */
  static async open(gl, url, failed = (error) => console.error(error)) {
    const source = new ByteSource(new URL(url, document.baseURI).href, 15000);
    return new FourdScene(gl, await SceneFile.open(source), new DecodePool(), failed);
  }

  /**
   * @param {WebGL2RenderingContext} gl
   * @param {SceneFile} file
   * @param {DecodePool} pool Released with the scene.
   * @param {(error: unknown) => void} failed
   */
  constructor(gl, file, pool, failed) {
    this.manifest = file.manifest;
    this.pool = pool;
    setInitialState(gl);
    this.points = new ProjectedPoints(gl, file.manifest);
    this.renderer = new HostRenderer(gl, file.manifest, this.points);
    this.playback = new Playback(file, pool, () => {}, failed);
    /** The matrix that maps the scene's world to the host's world, by a rotation, a translation and a uniform scale. */
    this.matrix = /** @type {ArrayLike<number>} */ (IDENTITY);
  }

  /** The playback clock, with `seconds`, `speed`, `isPlaying`, `loops`, `frame`, `seek(frame)` and `toggle()`. */
  get clock() {
    return this.playback.clock;
  }

  /**
   * Places the scene upright in the host's world: its focus at the origin, the up direction of its cameras along +y,
   * and the horizontal viewing direction of its first camera along -z.
   * @param {number} distance Distance of the first camera from the origin in the host's units, which determines the
   *   scale of the scene.
   */
  placeUpright(distance) {
    const { cameras, focus } = this.manifest;
    const [camera] = cameras;
    if (!camera) throw new SceneError("The scene has no cameras; export it again");
    const eye = apply(transpose(camera.rotation), camera.translation).map((value) => -value);
    const forward = addScaled(focus, -1, eye);
    this.matrix = uprightMatrix(focus, estimateUp(cameras), forward, distance / Math.max(length(forward), 1e-12));
  }

  /** Whether `draw` shows points. */
  get isDrawable() {
    return this.playback.order !== null;
  }

  /**
   * Whether `draw` shows the current frame with all source views from `view`, which must have been passed to `update`.
   * @param {View} view
   */
  isSettled(view) {
    return this.playback.isSettled(this.#host(view).camera);
  }

  /**
   * Advances the time by `elapsed` seconds, loads frames and sorts their points for a view.
   *
   * Both eyes of a headset share one depth order. It is exact for both if they look in the same direction and neither
   * eye is in front of the other.
   * @param {number} elapsed
   * @param {View} view
   */
  update(elapsed, view) {
    this.playback.update(elapsed, this.#host(view).camera);
  }

  /**
   * Composites the points over the content of a framebuffer. Colours are sRGB, as in images. At each pixel, the K
   * nearest points in front of the host's objects are composited.
   * @param {View} view
   * @param {object} [target]
   * @param {WebGLFramebuffer | null} [target.framebuffer] null, the default, is the canvas.
   * @param {WebGLTexture | null} [target.depthTexture] Depth of the host's objects, which hide the points behind them.
   *   The texture must have one texel per framebuffer pixel and the filter NEAREST. It must not be multisampled or
   *   attached to the framebuffer.
   * @param {boolean} [target.writesDepth] Whether the points' mean depth is written into the framebuffer's depth
   *   buffer, at pixels where their alpha is at least 0.5, so that the points hide objects that the host draws later.
   * @param {View} [target.selectedFor] View for which the source views are selected, by default `view`. Pass the same
   *   view for both eyes of a headset.
   */
  draw(view, { framebuffer = null, depthTexture = null, writesDepth = false, selectedFor = view } = {}) {
    const { camera, depthRange } = this.#host(view);
    const selection = selectSourceViews(this.#host(selectedFor).camera, this.manifest);
    const picture = this.playback.picture(camera, selection);
    const [x, y] = view.viewport;
    if (picture) this.renderer.draw(picture, { framebuffer, corner: [x, y], depthRange, depthTexture, writesDepth });
  }

  /** Stops the workers and deletes all WebGL objects that the scene has created. */
  release() {
    this.playback.release();
    this.renderer.release();
    this.points.release();
    this.pool.release();
  }

  /** @param {View} view */
  #host({ viewMatrix, projectionMatrix, viewport }) {
    return hostCamera(multiply4(viewMatrix, this.matrix), projectionMatrix, viewport[2], viewport[3]);
  }
}
