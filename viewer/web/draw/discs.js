import { MAX_BLENDED, bindTexture, makeProgram } from "./gl.js";
import { NO_FRAGMENT, SHADE_VERTEX, quadVertex, spriteVertex } from "./shaders.js";
/** @typedef {import("../scene/manifest.js").Manifest} Manifest */
/** @typedef {import("../scene/manifest.js").Camera} Camera */
/** @typedef {import("./frame_textures.js").FrameTextures} FrameTextures */

const BYTES_PER_DISC = 32;

/**
 * The programs of a pass that draws discs. Sprites need a quarter of the vertices of quads, but drivers limit their
 * size, so large discs are drawn as quads. The pass of a style has its own vertex arrays, which also contain normals.
 * @typedef {{sprite: import("./gl.js").Program, quad: import("./gl.js").Program, arrays?: DiscArrays}} DiscPass
 */

/** Vertex arrays of the discs. @typedef {{sprite: WebGLVertexArrayObject, quad: WebGLVertexArrayObject}} DiscArrays */

/** The projected and shaded points in depth order, which all passes of an image draw. */
export class Discs {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {Manifest} manifest
   */
  constructor(gl, manifest) {
    this.gl = gl;
    this.manifest = manifest;
    this.shade = makeProgram(gl, SHADE_VERTEX, NO_FRAGMENT, { attributes: ["point"], varyings: ["disc", "paint"] });
    this.feedback = gl.createTransformFeedback();
    this.count = 0;
    this.capacity = 0;
    this.order = gl.createBuffer();
    this.discs = gl.createBuffer();
    this.shadeArray = gl.createVertexArray();
    /** @type {DiscArrays} */
    this.arrays = { sprite: gl.createVertexArray(), quad: gl.createVertexArray() };
    /** @type {number} */
    this.maxSprite = gl.getParameter(gl.ALIASED_POINT_SIZE_RANGE)[1];
    /** @type {[number, number]} */
    this.maxViewport = gl.getParameter(gl.MAX_VIEWPORT_DIMS);
    /** Upper bound of the discs' radii in pixels. */
    this.largestDisc = 0;
    this.#makeArrays();
    /** @type {Uint32Array | null} */
    this.loadedOrder = null;
  }

  /**
   * @param {string} fragment
   * @param {string} depth GLSL expression of the discs' depth in normalised device coordinates.
   * @returns {DiscPass}
   */
  makePass(fragment, depth) {
    const options = { attributes: ["disc", "paint"] };
    const sprite = makeProgram(this.gl, spriteVertex(depth), fragment, options);
    return { sprite, quad: makeProgram(this.gl, quadVertex(depth), fragment, options) };
  }

  /**
   * Projects and shades the points.
   * @param {FrameTextures} textures
   * @param {{points: Uint32Array, ratio: number}} order Indices of the points, nearest first, and an upper bound of
   *   radius / depth over all points.
   * @param {Camera} camera
   * @param {{layers: number[], weights: number[]}} blended Texture layers of the views to blend, and the view weights.
   * @param {boolean} hasShadow
   */
  project(textures, order, camera, blended, hasShadow) {
    const { gl, shade } = this;
    this.#loadOrder(order.points);
    this.largestDisc = camera.intrinsics[4] * order.ratio;
    if (this.count === 0) return;
    shade.use();
    bindTexture(gl, 0, textures.xyz);
    bindTexture(gl, 1, textures.sizes);
    bindTexture(gl, 2, textures.harmonics);
    bindTexture(gl, 3, textures.views, gl.TEXTURE_2D_ARRAY);
    bindTexture(gl, 4, textures.shadow);
    shade.integers({ xyz: 0, sizes: 1, harmonics: 2, views: 3, shadow: 4, has_shadow: hasShadow });
    shade.integers({ block_rows: textures.rows, background_first: textures.backgroundFirst });
    this.#setCamera(camera);
    this.#setShading(blended);
    this.transform(this.feedback, this.discs);
  }

  /**
   * Runs the current vertex shader for all points in depth order, and stores its outputs.
   * @param {WebGLTransformFeedback} feedback
   * @param {WebGLBuffer} buffer
   */
  transform(feedback, buffer) {
    const { gl } = this;
    gl.bindVertexArray(this.shadeArray);
    gl.bindTransformFeedback(gl.TRANSFORM_FEEDBACK, feedback);
    gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, buffer);
    gl.enable(gl.RASTERIZER_DISCARD);
    gl.beginTransformFeedback(gl.POINTS);
    gl.drawArrays(gl.POINTS, 0, this.count);
    gl.endTransformFeedback();
    gl.disable(gl.RASTERIZER_DISCARD);
    gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, null);
    gl.bindTransformFeedback(gl.TRANSFORM_FEEDBACK, null);
  }

  /**
   * Draws all discs into the bound framebuffer.
   * @param {DiscPass} pass
   * @param {number} width Width of the image in pixels.
   * @param {number} height
   * @param {Record<string, number | boolean>} [integers] Texture units and other uniforms of the pass.
   * @param {Record<string, number | number[]>} [floats]
   */
  draw(pass, width, height, integers = {}, floats = {}) {
    const { gl } = this;
    if (this.count === 0) return;
    const margin = Math.ceil(this.largestDisc) + 1;
    const isSprite = 2 * margin <= this.maxSprite && width + 2 * margin <= this.maxViewport[0] && height + 2 * margin <= this.maxViewport[1];
    const program = isSprite ? pass.sprite : pass.quad;
    const arrays = pass.arrays ?? this.arrays;
    program.use();
    program.integers(integers);
    program.floats({ ...floats, size: [width, height] });
    if (isSprite) {
      program.floats({ margin });
      // The viewport extends past the image, because WebGL drops sprites whose centre is outside the viewport.
      gl.viewport(-margin, -margin, width + 2 * margin, height + 2 * margin);
      gl.bindVertexArray(arrays.sprite);
      gl.drawArrays(gl.POINTS, 0, this.count);
    } else {
      gl.viewport(0, 0, width, height);
      gl.bindVertexArray(arrays.quad);
      gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, this.count);
    }
    gl.viewport(0, 0, width, height);
  }

  release() {
    const { gl } = this;
    for (const buffer of [this.order, this.discs]) gl.deleteBuffer(buffer);
    for (const array of [this.shadeArray, ...Object.values(this.arrays)]) gl.deleteVertexArray(array);
    gl.deleteTransformFeedback(this.feedback);
    this.shade.release();
  }

  #makeArrays() {
    const { gl } = this;
    gl.bindVertexArray(this.shadeArray);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 4, 0);
    this.describe(this.arrays.sprite, 0);
    this.describe(this.arrays.quad, 1);
    gl.bindVertexArray(null);
    gl.bindBuffer(gl.ARRAY_BUFFER, null);
  }

  /**
   * Sets up a vertex array with `disc` as attribute 0 and `paint` as attribute 1.
   * @param {WebGLVertexArrayObject} array
   * @param {number} divisor 0 for one disc per vertex, 1 for one disc per instance.
   */
  describe(array, divisor) {
    const { gl } = this;
    gl.bindVertexArray(array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.discs);
    for (const location of [0, 1]) {
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, 4, gl.FLOAT, false, BYTES_PER_DISC, 16 * location);
      gl.vertexAttribDivisor(location, divisor);
    }
  }

  /** @param {Uint32Array} order */
  #loadOrder(order) {
    const { gl } = this;
    this.count = order.length;
    if (order === this.loadedOrder) return;
    this.loadedOrder = order;
    gl.bindVertexArray(null);
    if (order.length > this.capacity) {
      this.capacity = Math.ceil(1.25 * order.length);
      gl.bindBuffer(gl.ARRAY_BUFFER, this.discs);
      gl.bufferData(gl.ARRAY_BUFFER, BYTES_PER_DISC * this.capacity, gl.DYNAMIC_COPY);
      gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
      gl.bufferData(gl.ARRAY_BUFFER, 4 * this.capacity, gl.DYNAMIC_DRAW);
    }
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.bufferSubData(gl.ARRAY_BUFFER, 0, order);
    gl.bindBuffer(gl.ARRAY_BUFFER, null);
  }

  /** @param {Camera} camera */
  #setCamera({ intrinsics, rotation, translation }) {
    const [r0, r1, r2, r3, r4, r5, r6, r7, r8] = rotation;
    const [x, y, z] = translation;
    this.shade.floats({
      intrinsics_x: intrinsics.slice(0, 3),
      intrinsics_y: intrinsics.slice(3, 6),
      rotation_x: [r0, r1, r2],
      rotation_y: [r3, r4, r5],
      rotation_z: [r6, r7, r8],
      translation,
      camera_centre: [-(r0 * x + r3 * y + r6 * z), -(r1 * x + r4 * y + r7 * z), -(r2 * x + r5 * y + r8 * z)],
      near: this.manifest.near,
    });
  }

  /** @param {{layers: number[], weights: number[]}} blended */
  #setShading({ layers, weights }) {
    const { gl, shade, manifest } = this;
    const clouds = [manifest.dynamicEncoding, manifest.backgroundEncoding ?? manifest.dynamicEncoding];
    const scales = clouds.flatMap((cloud) => [cloud.radiusLower, cloud.radiusSteps, cloud.densityLevels, 0]);
    gl.uniform4fv(shade.location("radius_density"), scales);
    gl.uniform1fv(shade.location("weight_steps"), clouds.map((cloud) => cloud.weightSteps));
    const count = Math.min(layers.length, MAX_BLENDED);
    if (count > 0) {
      gl.uniform1iv(shade.location("blended_layers"), layers.slice(0, count));
      gl.uniform1fv(shade.location("view_weights"), weights.slice(0, count));
    }
    shade.integers({ blended_count: count });
    shade.floats({ sh_range: manifest.shRange, sh_base: manifest.shBase });
  }
}
