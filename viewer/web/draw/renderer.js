import { SceneError } from "../scene/errors.js";
import { FULL_SCREEN_VERTEX } from "../shaders/fullscreen.vert.js";
import { PeelingCompositor, SortedCompositor } from "./compositors.js";
import { bindTexture, makeProgram } from "./gl.js";
import { ProjectedPoints } from "./projected_points.js";
import { OVER_BACKGROUND_FRAGMENT, SCALE_FRAGMENT } from "./shaders.js";
import { StyledDrawing } from "../stylize/styled_drawing.js";
/** @typedef {import("../scene/manifest.js").Manifest} Manifest */
/** @typedef {import("./projected_points.js").Picture} Picture */
/** @typedef {import("../stylize/styled_drawing.js").ReadyStyle} ReadyStyle */

/** @typedef {"sorted" | "reference"} Mode One-pass compositing of sorted discs, or exact depth peeling. */

/** Draws pictures into a canvas with WebGL 2. */
export class CanvasRenderer {
  /**
   * @param {HTMLCanvasElement | OffscreenCanvas} canvas
   * @param {Manifest} manifest
   */
  constructor(canvas, manifest) {
    const options = { alpha: false, antialias: false, depth: false, stencil: false, preserveDrawingBuffer: false };
    const gl = /** @type {WebGL2RenderingContext | null} */ (canvas.getContext("webgl2", options));
    if (!gl) {
      throw new SceneError("WebGL: expected WebGL 2, got a browser without it; switch on hardware acceleration");
    }
    this.gl = gl;
    this.canvas = canvas;
    this.manifest = manifest;
    this.points = new ProjectedPoints(gl, manifest);
    this.overBackground = makeProgram(gl, FULL_SCREEN_VERTEX, OVER_BACKGROUND_FRAGMENT);
    this.scale = makeProgram(gl, FULL_SCREEN_VERTEX, SCALE_FRAGMENT);
    /** @type {StyledDrawing | null} */
    this.styled = null;
    this.emptyArray = gl.createVertexArray();
    /** @type {Partial<Record<Mode, SortedCompositor | PeelingCompositor>>} */
    this.compositors = {};
  }

  /**
   * Draws a picture into the canvas. The picture is scaled to the size of the canvas.
   * @param {Picture} picture
   * @param {Mode} mode
   * @param {[number, number, number]} background Colour in [0, 1].
   * @param {ReadyStyle | null} [style] Ignored until the normals of all points are loaded. Images in a style are
   *   always composited in one pass.
   */
  draw(picture, mode, background, style = null) {
    const { gl } = this;
    if (gl.isContextLost()) return;
    this.points.project(picture);
    if (style && picture.clouds.every((cloud) => !cloud || cloud.normals)) {
      this.styled ??= new StyledDrawing(gl, this.points, this.manifest.focus);
      this.#present(this.scale, this.styled.draw(picture, style, background));
      return;
    }
    const { width, height } = picture.camera;
    const image = this.#compositor(mode).draw(width, height, picture.layers);
    this.#present(this.overBackground, image, { background, pixel_filter: this.manifest.pixelFilter });
  }

  /**
   * Returns the pixels of the canvas, which must have been drawn in the same task.
   * @returns {Uint8Array} (height, width, 4), row 0 at the top.
   */
  readPixels() {
    const { gl } = this;
    const { width, height } = this.canvas;
    const bytes = new Uint8Array(4 * width * height);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.readPixels(0, 0, width, height, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
    const flipped = new Uint8Array(bytes.length);
    for (let row = 0; row < height; row++) {
      flipped.set(bytes.subarray(4 * width * row, 4 * width * (row + 1)), 4 * width * (height - 1 - row));
    }
    return flipped;
  }

  /** Deletes all WebGL objects. The WebGL context of the canvas is kept. */
  release() {
    for (const compositor of Object.values(this.compositors)) compositor.release();
    this.points.release();
    this.overBackground.release();
    this.scale.release();
    this.styled?.release();
    this.gl.deleteVertexArray(this.emptyArray);
  }

  /** @param {Mode} mode */
  #compositor(mode) {
    const { discs } = this.points;
    this.compositors[mode] ??= mode === "sorted" ? new SortedCompositor(this.gl, discs) : new PeelingCompositor(this.gl, discs);
    return this.compositors[mode];
  }

  /**
   * @param {import("./gl.js").Program} program
   * @param {WebGLTexture} image
   * @param {Record<string, number | number[]>} [floats]
   */
  #present(program, image, floats = {}) {
    const { gl } = this;
    const { width, height } = this.canvas;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, width, height);
    bindTexture(gl, 0, image);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.LINEAR);
    program.use();
    program.integers({ image: 0 });
    program.floats({ ...floats, target: [width, height] });
    gl.bindVertexArray(this.emptyArray);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }
}
