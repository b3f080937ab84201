import { SceneError } from "../scene/errors.js";

/** @typedef {WebGL2RenderingContext} GL */

/** Width in texels of the textures that store arrays. */
export const TEXELS_PER_ROW = 4096;
/** Largest number of source views that are blended. */
export const MAX_BLENDED = 64;

/** The first lines of every shader. */
const HEADER = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
precision highp usampler2D;
precision highp isampler2D;
precision highp sampler2DArray;
#define TEXELS_PER_ROW ${TEXELS_PER_ROW}
#define MAX_BLENDED ${MAX_BLENDED}
`;

/**
 * Compiles a program. The texts of the shaders have no line `#version`.
 * @param {GL} gl
 * @param {string} vertex
 * @param {string} fragment
 * @param {{varyings?: string[], attributes?: string[]}} [options] `attributes` are bound to the locations 0, 1, ...
 */
export function makeProgram(gl, vertex, fragment, options = {}) {
  const program = gl.createProgram();
  const shaders = [compile(gl, gl.VERTEX_SHADER, vertex), compile(gl, gl.FRAGMENT_SHADER, fragment)];
  for (const shader of shaders) gl.attachShader(program, shader);
  (options.attributes ?? []).forEach((name, location) => gl.bindAttribLocation(program, location, name));
  if (options.varyings) gl.transformFeedbackVaryings(program, options.varyings, gl.INTERLEAVED_ATTRIBS);
  gl.linkProgram(program);
  for (const shader of shaders) gl.deleteShader(shader);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new SceneError(`WebGL: expected shaders that link, got '${gl.getProgramInfoLog(program)}'; update the browser`);
  }
  return new Program(gl, program);
}

/** A program and the locations of its uniforms. */
export class Program {
  /**
   * @param {GL} gl
   * @param {WebGLProgram} program
   */
  constructor(gl, program) {
    this.gl = gl;
    this.program = program;
    /** @type {Map<string, WebGLUniformLocation | null>} */
    this.locations = new Map();
  }

  use() {
    this.gl.useProgram(this.program);
  }

  release() {
    this.gl.deleteProgram(this.program);
  }

  /** @param {string} name */
  location(name) {
    if (!this.locations.has(name)) this.locations.set(name, this.gl.getUniformLocation(this.program, name));
    return this.locations.get(name) ?? null;
  }

  /**
   * Sets uniforms that are floats, vectors of 2 to 4 floats, or longer arrays of floats. This program must be the
   * current program.
   * @param {Record<string, number | number[]>} values
   */
  floats(values) {
    for (const [name, value] of Object.entries(values)) {
      const location = this.location(name);
      if (typeof value === "number") this.gl.uniform1f(location, value);
      else if (value.length === 2) this.gl.uniform2fv(location, value);
      else if (value.length === 3) this.gl.uniform3fv(location, value);
      else if (value.length === 4) this.gl.uniform4fv(location, value);
      else this.gl.uniform1fv(location, value);
    }
  }

  /**
   * Sets uniforms that are integers, booleans or texture units. This program must be the current program.
   * @param {Record<string, number | boolean>} values
   */
  integers(values) {
    for (const [name, value] of Object.entries(values)) this.gl.uniform1i(this.location(name), Number(value));
  }
}

/**
 * @param {GL} gl
 * @param {number} type
 * @param {string} source
 */
function compile(gl, type, source) {
  const shader = gl.createShader(type);
  if (!shader) throw new SceneError("WebGL: expected a shader, got none; reload the page");
  gl.shaderSource(shader, HEADER + source);
  gl.compileShader(shader);
  if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
    throw new SceneError(`WebGL: expected valid shaders, got '${gl.getShaderInfoLog(shader)}'; update the browser`);
  }
  return shader;
}

/**
 * Creates a texture without filtering.
 * @param {GL} gl
 * @param {number} format Sized internal format.
 * @param {number} width
 * @param {number} height
 * @param {number} [layers] Number of layers of an array texture.
 */
export function makeTexture(gl, format, width, height, layers) {
  const target = layers === undefined ? gl.TEXTURE_2D : gl.TEXTURE_2D_ARRAY;
  const texture = gl.createTexture();
  gl.bindTexture(target, texture);
  if (layers === undefined) gl.texStorage2D(target, 1, format, width, height);
  else gl.texStorage3D(target, 1, format, width, height, layers);
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(target, name, gl.NEAREST);
  for (const name of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(target, name, gl.CLAMP_TO_EDGE);
  return texture;
}

/**
 * @param {GL} gl
 * @param {number} unit
 * @param {WebGLTexture | null} texture
 * @param {number} [target]
 */
export function bindTexture(gl, unit, texture, target = gl.TEXTURE_2D) {
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(target, texture);
}

/**
 * Creates a framebuffer that draws into textures.
 * @param {GL} gl
 * @param {WebGLTexture[]} textures
 * @param {{attachment: number, buffer: WebGLRenderbuffer}} [depth]
 */
export function makeFramebuffer(gl, textures, depth) {
  const framebuffer = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
  const attachments = textures.map((texture, index) => {
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + index, gl.TEXTURE_2D, texture, 0);
    return gl.COLOR_ATTACHMENT0 + index;
  });
  gl.drawBuffers(attachments);
  if (depth) gl.framebufferRenderbuffer(gl.FRAMEBUFFER, depth.attachment, gl.RENDERBUFFER, depth.buffer);
  const status = gl.checkFramebufferStatus(gl.FRAMEBUFFER);
  if (status !== gl.FRAMEBUFFER_COMPLETE && !gl.isContextLost()) {
    throw new SceneError(`WebGL: expected a complete framebuffer, got status ${status}; update the graphics driver`);
  }
  return framebuffer;
}

/**
 * Sets all WebGL state that affects how the player draws. This is needed because another program may have changed it.
 * @param {GL} gl
 */
export function setInitialState(gl) {
  for (const test of [gl.BLEND, gl.CULL_FACE, gl.DEPTH_TEST, gl.DITHER, gl.POLYGON_OFFSET_FILL, gl.RASTERIZER_DISCARD]) {
    gl.disable(test);
  }
  for (const test of [gl.SAMPLE_ALPHA_TO_COVERAGE, gl.SAMPLE_COVERAGE, gl.SCISSOR_TEST, gl.STENCIL_TEST]) gl.disable(test);
  gl.colorMask(true, true, true, true);
  gl.depthMask(true);
  gl.depthRange(0, 1);
  gl.stencilMask(0xff);
  gl.bindVertexArray(null);
  for (const name of [gl.UNPACK_FLIP_Y_WEBGL, gl.UNPACK_PREMULTIPLY_ALPHA_WEBGL]) gl.pixelStorei(name, false);
  for (const name of [gl.UNPACK_ROW_LENGTH, gl.UNPACK_IMAGE_HEIGHT, gl.UNPACK_SKIP_PIXELS, gl.UNPACK_SKIP_ROWS]) {
    gl.pixelStorei(name, 0);
  }
  gl.pixelStorei(gl.UNPACK_SKIP_IMAGES, 0);
  gl.bindBuffer(gl.PIXEL_UNPACK_BUFFER, null);
  for (let unit = 0; unit < 5; unit++) gl.bindSampler(unit, null);
}
