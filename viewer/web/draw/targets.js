import { SceneError } from "../scene/errors.js";
import { makeFramebuffer, makeTexture } from "./gl.js";

/** Textures of one size, with a framebuffer that draws into all of them. */
export class Target {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {number} width
   * @param {number} height
   * @param {number[]} formats
   * @param {number} [depthFormat]
   * @param {number} [attachment]
   */
  constructor(gl, width, height, formats, depthFormat, attachment) {
    this.gl = gl;
    this.width = width;
    this.height = height;
    this.textures = formats.map((format) => makeTexture(gl, format, width, height));
    /** @type {WebGLRenderbuffer | null} */
    this.buffer = null;
    let depth;
    if (depthFormat !== undefined && attachment !== undefined) {
      this.buffer = gl.createRenderbuffer();
      gl.bindRenderbuffer(gl.RENDERBUFFER, this.buffer);
      gl.renderbufferStorage(gl.RENDERBUFFER, depthFormat, width, height);
      depth = { attachment, buffer: this.buffer };
    }
    this.framebuffer = makeFramebuffer(gl, this.textures, depth);
  }

  release() {
    this.gl.deleteFramebuffer(this.framebuffer);
    this.gl.deleteRenderbuffer(this.buffer);
    for (const texture of this.textures) this.gl.deleteTexture(texture);
  }
}

/**
 * Throws a SceneError if the browser cannot draw into textures of floats.
 * @param {WebGL2RenderingContext} gl
 * @param {string} extension
 */
export function requireFloatTargets(gl, extension) {
  if (gl.getExtension("EXT_color_buffer_float") || gl.getExtension(extension)) return;
  throw new SceneError(`WebGL: expected the extension ${extension}, got none; use a newer browser or graphics driver`);
}

/**
 * Composites premultiplied colours behind the content of the framebuffer.
 * @param {WebGL2RenderingContext} gl
 */
export function blendUnder(gl) {
  gl.disable(gl.DEPTH_TEST);
  gl.enable(gl.BLEND);
  gl.blendEquation(gl.FUNC_ADD);
  gl.blendFunc(gl.ONE_MINUS_DST_ALPHA, gl.ONE);
}
