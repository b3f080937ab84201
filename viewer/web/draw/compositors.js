import { COPY_FRAGMENT } from "../shaders/copy.frag.js";
import { FULL_SCREEN_VERTEX } from "../shaders/fullscreen.vert.js";
import { bindTexture, makeProgram } from "./gl.js";
import { NO_DEPTH, PEEL_FRAGMENT, RANK_DEPTH, SORTED_FRAGMENT } from "./shaders.js";
import { Target, blendUnder, requireFloatTargets } from "./targets.js";
/** @typedef {import("./discs.js").Discs} Discs */

/** A number larger than the rank of every layer. A rank is a position in depth order, counted from 1. */
const NONE = 1e9;

/**
 * @typedef {object} Compositor
 * @property {(width: number, height: number, layers: number) => WebGLTexture} draw Composites the discs into a
 *   texture (RGBA16F, premultiplied). Row 0 of the texture is the top of the image.
 * @property {() => void} release
 */

/**
 * Composites up to K discs per pixel in one pass. Discs are drawn from the nearest to the farthest, and each is blended
 * behind the earlier ones. The stencil buffer counts the discs per pixel, so that exactly the K nearest are composited.
 * @implements {Compositor}
 */
export class SortedCompositor {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {Discs} discs
   * @param {{fragment?: string, depth?: string, outputs?: number, pass?: import("./discs.js").DiscPass}} [options]
   *   `fragment` is the fragment shader of the discs, `depth` is the GLSL expression of their depth, and `outputs` is
   *   the number of textures (RGBA16F) that the shader draws into. If `pass` is given, its programs draw the discs
   *   instead, and `fragment` and `depth` are ignored.
   */
  constructor(gl, discs, { fragment = SORTED_FRAGMENT, depth = NO_DEPTH, outputs = 1, pass } = {}) {
    requireFloatTargets(gl, "EXT_color_buffer_half_float");
    this.gl = gl;
    this.discs = discs;
    this.formats = new Array(outputs).fill(gl.RGBA16F);
    this.pass = pass ?? discs.makePass(fragment, depth);
    /** @type {Target | null} */
    this.target = null;
  }

  /**
   * @param {number} width
   * @param {number} height
   * @param {number} layers
   * @param {Record<string, number | boolean>} [integers] Uniforms of the fragment shader.
   * @param {Record<string, number | number[]>} [floats]
   */
  draw(width, height, layers, integers, floats) {
    return this.drawAll(width, height, layers, integers, floats)[0];
  }

  /**
   * Draws as `draw` does, but returns the textures of all outputs.
   * @param {number} width
   * @param {number} height
   * @param {number} layers
   * @param {Record<string, number | boolean>} [integers]
   * @param {Record<string, number | number[]>} [floats]
   */
  drawAll(width, height, layers, integers, floats) {
    const { gl } = this;
    if (!this.target || this.target.width !== width || this.target.height !== height) {
      this.target?.release();
      this.target = new Target(gl, width, height, this.formats, gl.DEPTH24_STENCIL8, gl.DEPTH_STENCIL_ATTACHMENT);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target.framebuffer);
    gl.clearColor(0, 0, 0, 0);
    gl.clearStencil(0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    blendUnder(gl);
    gl.enable(gl.STENCIL_TEST);
    gl.stencilFunc(gl.GREATER, layers, 0xff);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
    this.discs.draw(this.pass, width, height, integers, floats);
    gl.disable(gl.STENCIL_TEST);
    gl.disable(gl.BLEND);
    return this.target.textures;
  }

  release() {
    this.target?.release();
    this.target = null;
    this.pass.sprite.release();
    this.pass.quad.release();
  }
}

/**
 * Depth peeling (Everitt 2001), as in 4K4D. Each of the K passes finds the next depth layer of every pixel, which is
 * exact but slow.
 * @implements {Compositor}
 */
export class PeelingCompositor {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {Discs} discs
   */
  constructor(gl, discs) {
    requireFloatTargets(gl, "EXT_color_buffer_float");
    this.gl = gl;
    this.discs = discs;
    this.peel = discs.makePass(PEEL_FRAGMENT, RANK_DEPTH);
    this.copy = makeProgram(gl, FULL_SCREEN_VERTEX, COPY_FRAGMENT);
    this.emptyArray = gl.createVertexArray();
    /** Two targets that alternate, because each pass reads the ranks that the previous pass wrote. @type {Target[]} */
    this.layers = [];
    /** @type {Target | null} */
    this.sum = null;
  }

  /**
   * @param {number} width
   * @param {number} height
   * @param {number} layers
   */
  draw(width, height, layers) {
    const { gl } = this;
    const sum = this.#resize(width, height);
    clear(gl, sum.framebuffer, [0, 0, 0, 0]);
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.layers[1].framebuffer);
    gl.clearBufferfv(gl.COLOR, 1, [0, 0, 0, 0]);
    for (let layer = 0; layer < layers; layer++) {
      const current = this.layers[layer % 2];
      this.#peelLayer(current, this.layers[1 - (layer % 2)], width, height);
      gl.bindFramebuffer(gl.FRAMEBUFFER, sum.framebuffer);
      blendUnder(gl);
      bindTexture(gl, 0, current.textures[0]);
      this.copy.use();
      this.copy.integers({ image: 0 });
      gl.bindVertexArray(this.emptyArray);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
      gl.disable(gl.BLEND);
    }
    return sum.textures[0];
  }

  release() {
    this.#releaseTargets();
    for (const program of [this.peel.sprite, this.peel.quad, this.copy]) program.release();
    this.gl.deleteVertexArray(this.emptyArray);
  }

  #releaseTargets() {
    for (const target of [...this.layers, this.sum]) target?.release();
    this.layers = [];
    this.sum = null;
  }

  /**
   * @param {Target} current
   * @param {Target} previous
   * @param {number} width
   * @param {number} height
   */
  #peelLayer(current, previous, width, height) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, current.framebuffer);
    gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0]);
    gl.clearBufferfv(gl.COLOR, 1, [NONE, 0, 0, 0]);
    gl.clearBufferfv(gl.DEPTH, 0, [1]);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LESS);
    bindTexture(gl, 0, previous.textures[1]);
    this.discs.draw(this.peel, width, height, { peeled_rank: 0 });
    gl.disable(gl.DEPTH_TEST);
  }

  /**
   * @param {number} width
   * @param {number} height
   */
  #resize(width, height) {
    const { gl } = this;
    if (this.sum && this.sum.width === width && this.sum.height === height) return this.sum;
    this.#releaseTargets();
    this.layers = [0, 1].map(
      () => new Target(gl, width, height, [gl.RGBA16F, gl.R32F], gl.DEPTH_COMPONENT24, gl.DEPTH_ATTACHMENT),
    );
    this.sum = new Target(gl, width, height, [gl.RGBA16F]);
    return this.sum;
  }
}

/**
 * @param {WebGL2RenderingContext} gl
 * @param {WebGLFramebuffer} framebuffer
 * @param {number[]} colour
 */
function clear(gl, framebuffer, colour) {
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  gl.clearBufferfv(gl.COLOR, 0, colour);
}
