import { SceneError } from "../scene/errors.js";
import { SH_NUMBERS } from "../scene/manifest.js";
import { FULL_SCREEN_VERTEX } from "../shaders/fullscreen.vert.js";
import { TEXELS_PER_ROW, bindTexture, makeFramebuffer, makeProgram, makeTexture } from "./gl.js";
import { HARMONICS_FRAGMENT } from "./shaders.js";
/** @typedef {import("../scene/manifest.js").Manifest} Manifest */
/** @typedef {import("../scene/manifest.js").CloudEncoding} CloudEncoding */
/** @typedef {import("../decode/cloud.js").CloudBase} CloudBase */

/**
 * A decoded cloud: the points, their colours in some source views and, if needed, their octahedral normals (N, 2).
 * @typedef {{base: CloudBase, views: Map<number, Uint8Array<ArrayBuffer>>, normals: Uint8Array<ArrayBuffer> | null}} Cloud
 */

const BLOCKS = 6;
const BASIS_FLOATS = 4 * (SH_NUMBERS * 12 + 12);

/**
 * Textures with the points of one frame and of the background. Dynamic points come first. The background starts at a
 * fixed row, so that it needs to be uploaded only once.
 */
export class FrameTextures {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {Manifest} manifest
   */
  constructor(gl, manifest) {
    this.gl = gl;
    this.manifest = manifest;
    this.backgroundFirst = backgroundFirst(manifest);
    this.dynamicRows = this.backgroundFirst / TEXELS_PER_ROW;
    const backgroundRows = rowsOf(manifest.background?.points ?? 0);
    this.rows = this.dynamicRows + backgroundRows;
    this.layers = 1 + Math.min(manifest.neighbours, manifest.sources.length);
    this.#checkLimits();
    this.xyz = makeTexture(gl, gl.RGB32F, TEXELS_PER_ROW, this.rows);
    this.sizes = makeTexture(gl, gl.R32UI, TEXELS_PER_ROW, this.rows);
    this.views = makeTexture(gl, gl.RGBA8, TEXELS_PER_ROW, this.rows, this.layers);
    this.harmonics = makeTexture(gl, gl.RGBA32UI, TEXELS_PER_ROW, BLOCKS * this.rows);
    this.shadow = makeTexture(gl, gl.R8UI, TEXELS_PER_ROW, Math.max(backgroundRows, 1));
    const factorRows = [manifest.dynamicEncoding, manifest.backgroundEncoding].map((encoding, index) =>
      encoding ? rowsOf(encoding.shRows * (index ? (manifest.background?.points ?? 0) : manifest.mostPoints)) : 0,
    );
    this.factors = makeTexture(gl, gl.R16I, TEXELS_PER_ROW, Math.max(...factorRows, 1));
    this.target = makeFramebuffer(gl, [this.harmonics]);
    this.program = makeProgram(gl, FULL_SCREEN_VERTEX, HARMONICS_FRAGMENT);
    gl.uniformBlockBinding(this.program.program, gl.getUniformBlockIndex(this.program.program, "Basis"), 0);
    this.bases = [manifest.dynamicEncoding, manifest.backgroundEncoding].map((encoding) => this.#makeBasis(encoding));
    this.emptyArray = gl.createVertexArray();
    /** @type {(CloudBase | null)[]} */
    this.loaded = [null, null];
    /** The content of each layer of `views`, for both clouds. @type {(Uint8Array | null)[][]} */
    this.layerContent = [new Array(this.layers).fill(null), new Array(this.layers).fill(null)];
    /** @type {number[]} */
    this.layerViews = new Array(this.layers).fill(-1);
    /** @type {Uint8Array | null} */
    this.loadedShadow = null;
    /** @type {WebGLTexture | null} */
    this.normals = null;
    /** @type {(Uint8Array | null)[]} */
    this.loadedNormals = [null, null];
  }

  /**
   * Uploads the arrays that have changed.
   * @param {(Cloud | null)[]} clouds Dynamic points and background.
   * @param {Uint8Array | null} shadow
   * @param {number[]} selected Source views to blend.
   * @returns {Map<number, number>} The texture layer of each selected view whose colours are loaded for all clouds.
   */
  load(clouds, shadow, selected) {
    const { gl } = this;
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    clouds.forEach((cloud, index) => cloud && this.#loadBase(cloud.base, index));
    if (shadow && shadow !== this.loadedShadow) {
      this.#write(this.shadow, 0, shadow, 1, gl.RED_INTEGER, gl.UNSIGNED_BYTE);
      this.loadedShadow = shadow;
    }
    const layers = this.#assignLayers(selected.filter((view) => clouds.every((cloud) => !cloud || cloud.views.has(view))));
    clouds.forEach((cloud, index) => {
      if (!cloud) return;
      this.#loadLayer(0, index, cloud.base.mean);
      for (const [view, layer] of layers) this.#loadLayer(layer, index, /** @type {Uint8Array} */ (cloud.views.get(view)));
    });
    return layers;
  }

  /**
   * Uploads the normals that have changed.
   * @param {(Cloud | null)[]} clouds
   * @returns {WebGLTexture} RG8: the bytes of the octahedral normals. Only styles need this texture.
   */
  loadNormals(clouds) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0); // Creating a texture binds it to the active unit.
    const texture = this.normals ?? makeTexture(gl, gl.RG8, TEXELS_PER_ROW, this.rows);
    this.normals = texture;
    clouds.forEach((cloud, index) => {
      if (!cloud?.normals || cloud.normals === this.loadedNormals[index]) return;
      this.#write(texture, index ? this.dynamicRows : 0, cloud.normals, 2, gl.RG, gl.UNSIGNED_BYTE);
      this.loadedNormals[index] = cloud.normals;
    });
    return texture;
  }

  release() {
    const { gl } = this;
    for (const texture of [this.xyz, this.sizes, this.views, this.harmonics, this.shadow, this.factors, this.normals]) {
      gl.deleteTexture(texture);
    }
    for (const buffer of this.bases) gl.deleteBuffer(buffer);
    gl.deleteFramebuffer(this.target);
    gl.deleteVertexArray(this.emptyArray);
    this.program.release();
  }

  #checkLimits() {
    const { gl } = this;
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    const layers = gl.getParameter(gl.MAX_ARRAY_TEXTURE_LAYERS);
    if (most < TEXELS_PER_ROW || BLOCKS * this.rows > most || this.layers > layers) {
      const needed = `${TEXELS_PER_ROW} x ${BLOCKS * this.rows} texels`;
      throw new SceneError(`WebGL: expected textures of ${needed} for this scene, got at most ${most}; use a larger GPU`);
    }
  }

  /** @param {CloudEncoding | null} encoding */
  #makeBasis(encoding) {
    const { gl } = this;
    const content = new Float32Array(BASIS_FLOATS);
    if (encoding) {
      content.set(encoding.shBasis);
      content.set(encoding.shMean, 4 * SH_NUMBERS * 12);
    }
    const buffer = gl.createBuffer();
    gl.bindBuffer(gl.UNIFORM_BUFFER, buffer);
    gl.bufferData(gl.UNIFORM_BUFFER, content, gl.STATIC_DRAW);
    return buffer;
  }

  /**
   * @param {CloudBase} base
   * @param {number} index 0 for the dynamic points, 1 for the background.
   */
  #loadBase(base, index) {
    if (this.loaded[index] === base) return;
    const { gl } = this;
    const row = index ? this.dynamicRows : 0;
    this.#write(this.xyz, row, base.xyz, 3, gl.RGB, gl.FLOAT);
    this.#write(this.sizes, row, base.sizes, 1, gl.RED_INTEGER, gl.UNSIGNED_INT);
    this.#write(this.factors, 0, base.factors, 1, gl.RED_INTEGER, gl.SHORT);
    this.#computeHarmonics(base, index, row);
    this.loaded[index] = base;
  }

  /**
   * @param {CloudBase} base
   * @param {number} index
   * @param {number} row
   */
  #computeHarmonics(base, index, row) {
    const { gl, program } = this;
    const encoding = index ? this.manifest.backgroundEncoding : this.manifest.dynamicEncoding;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.bindVertexArray(this.emptyArray);
    gl.disable(gl.BLEND);
    gl.bindBufferBase(gl.UNIFORM_BUFFER, 0, this.bases[index]);
    bindTexture(gl, 0, this.factors);
    program.use();
    program.integers({ factors: 0, rows: encoding?.shRows ?? 0, points: base.points });
    for (let block = 0; block < BLOCKS; block++) {
      const firstRow = block * this.rows + row;
      gl.viewport(0, firstRow, TEXELS_PER_ROW, rowsOf(base.points));
      program.integers({ block, first_row: firstRow });
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null); // Unbind the target, because later passes read the coefficients.
  }

  /**
   * Assigns a texture layer to each view. A view that already has a layer keeps it.
   * @param {number[]} views
   */
  #assignLayers(views) {
    const kept = this.layerViews.map((view) => (views.includes(view) ? view : -1));
    for (const view of views) {
      if (kept.includes(view)) continue;
      const free = kept.findIndex((owner, layer) => layer > 0 && owner === -1);
      kept[free] = view;
    }
    this.layerViews = kept;
    return new Map(views.map((view) => [view, kept.indexOf(view)]));
  }

  /**
   * @param {number} layer
   * @param {number} index
   * @param {Uint8Array} content (N, 4)
   */
  #loadLayer(layer, index, content) {
    if (this.layerContent[index][layer] === content) return;
    const { gl } = this;
    this.#write(this.views, index ? this.dynamicRows : 0, content, 4, gl.RGBA, gl.UNSIGNED_BYTE, layer);
    this.layerContent[index][layer] = content;
  }

  /**
   * Uploads an array of whole texels from the start of a row.
   * @param {WebGLTexture} texture
   * @param {number} row
   * @param {Float32Array | Uint32Array | Int16Array | Uint8Array} content
   * @param {number} components Numbers per texel.
   * @param {number} format
   * @param {number} type
   * @param {number} [layer]
   */
  #write(texture, row, content, components, format, type, layer) {
    const { gl } = this;
    const target = layer === undefined ? gl.TEXTURE_2D : gl.TEXTURE_2D_ARRAY;
    bindTexture(gl, 0, texture, target);
    const fullRows = Math.floor(content.length / (components * TEXELS_PER_ROW));
    const split = fullRows * components * TEXELS_PER_ROW;
    const parts = /** @type {const} */ ([
      [row, TEXELS_PER_ROW, fullRows, content.subarray(0, split)],
      [row + fullRows, (content.length - split) / components, 1, content.subarray(split)],
    ]);
    for (const [y, width, height, part] of parts) {
      if (width * height === 0) continue;
      if (layer === undefined) gl.texSubImage2D(target, 0, 0, y, width, height, format, type, part);
      else gl.texSubImage3D(target, 0, 0, y, layer, width, height, 1, format, type, part);
    }
  }
}

/**
 * Returns the index of the first background point in the textures, which store the points of a frame first. The
 * background starts at a new row, which is the same for all frames.
 * @param {Manifest} manifest
 */
export function backgroundFirst(manifest) {
  return TEXELS_PER_ROW * Math.max(rowsOf(manifest.mostPoints), 1);
}

/** @param {number} texels */
function rowsOf(texels) {
  return Math.ceil(texels / TEXELS_PER_ROW);
}
