import { SortedCompositor } from "../draw/compositors.js";
import { bindTexture, makeProgram, makeTexture } from "../draw/gl.js";
import { NO_DEPTH } from "../draw/shaders.js";
import { Target } from "../draw/targets.js";
import { FULL_SCREEN_VERTEX } from "../shaders/fullscreen.vert.js";
import { GAPS } from "../shaders/stylize/gaps.frag.js";
import { LINES } from "../shaders/stylize/lines.glsl.js";
import { OUTLINES } from "../shaders/stylize/outlines.frag.js";
import { PICTURE } from "../shaders/stylize/picture.frag.js";
import { SHADING } from "../shaders/stylize/shading.glsl.js";
import { SURFACE } from "../shaders/stylize/surface.frag.js";
import { DiscNormals, SURFACE_FRAGMENT } from "./disc_normals.js";
import { distanceTo, viewStyle } from "./view_style.js";
/** @typedef {import("../draw/gl.js").Program} Program */
/** @typedef {import("../draw/projected_points.js").Picture} Picture */
/** @typedef {import("../draw/projected_points.js").ProjectedPoints} ProjectedPoints */
/** @typedef {import("../scene/manifest.js").Camera} Camera */

/**
 * A style with its decompressed shade table.
 * @typedef {{style: import("./style_file.js").Style, table: Uint8Array}} ReadyStyle
 */

const TONES = 256;

/**
 * Draws images in a style, with the same fragment shaders as the viewer's window. Lines do not flicker in successive
 * images from one camera.
 */
export class StyledDrawing {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {ProjectedPoints} points The caller must release them.
   * @param {number[]} focus Centre of the scene.
   */
  constructor(gl, points, focus) {
    this.gl = gl;
    this.points = points;
    this.focus = focus;
    const normals = new DiscNormals(gl, points.discs);
    this.normals = normals;
    this.compositor = new SortedCompositor(gl, points.discs, {
      outputs: 3,
      pass: normals.makePass(SURFACE_FRAGMENT, NO_DEPTH),
    });
    const make = (/** @type {string} */ text) => makeProgram(gl, FULL_SCREEN_VERTEX, text);
    this.programs = {
      surface: make(SURFACE),
      close: make(GAPS),
      picture: make(LINES + SHADING + PICTURE),
      outlines: make(OUTLINES),
    };
    this.emptyArray = gl.createVertexArray();
    /** Albedo, inverse depth and normals of the last two images. @type {Target[]} */
    this.surfaces = [];
    /** The last two images without lines, and the states of their lines. @type {Target[]} */
    this.shaded = [];
    /** @type {Target | null} */
    this.picture = null;
    /** @type {Target | null} */
    this.closed = null;
    this.turn = 0;
    /** @type {Camera | null} */
    this.camera = null;
    /** @type {WebGLTexture | null} */
    this.table = null;
    /** Shade table of the last image, which identifies its style. @type {Uint8Array | null} */
    this.tableContent = null;
  }

  /**
   * Draws a picture whose points are already projected.
   * @param {Picture} picture
   * @param {ReadyStyle} ready
   * @param {[number, number, number]} background Colour in [0, 1].
   * @returns {WebGLTexture} RGBA8: colours over the paper. Row 0 of the texture is the top of the image.
   */
  draw(picture, ready, background) {
    const { gl, points } = this;
    const { camera, layers } = picture;
    this.#resize(camera.width, camera.height);
    const rests = this.camera !== null && isSameCamera(this.camera, camera);
    this.camera = camera;
    this.turn = 1 - this.turn;
    this.normals.project(points.textures.loadNormals(picture.clouds), points.textures.xyz, camera);
    const unit = distanceTo(camera, this.focus);
    const images = this.compositor.drawAll(camera.width, camera.height, layers, {}, { depth_unit: unit });
    gl.bindVertexArray(this.emptyArray);
    this.#drawSurface(images, unit, rests ? ready.style.persistence : 0);
    return this.#drawPicture(ready, background, rests);
  }

  release() {
    const { gl } = this;
    this.#releaseTargets();
    this.compositor.release();
    this.normals.release();
    for (const program of Object.values(this.programs)) program.release();
    gl.deleteVertexArray(this.emptyArray);
    gl.deleteTexture(this.table);
  }

  /**
   * @param {WebGLTexture[]} images Composited colours, normals and depths.
   * @param {number} unit
   * @param {number} persistence
   */
  #drawSurface([colours, normals, depths], unit, persistence) {
    const [, oldDepth, oldNormal] = this.surfaces[1 - this.turn].textures;
    this.#use(this.programs.surface, this.surfaces[this.turn], {
      colours,
      normals,
      depths,
      old_inverse_depth: oldDepth,
      old_normal: oldNormal,
    });
    this.programs.surface.integers({ is_upside_down: false });
    this.programs.surface.floats({ depth_unit: unit, persistence });
    this.gl.drawArrays(this.gl.TRIANGLES, 0, 3);
  }

  /**
   * @param {ReadyStyle} ready
   * @param {[number, number, number]} background
   * @param {boolean} rests
   */
  #drawPicture({ style, table }, background, rests) {
    const { gl, programs } = this;
    const closed = /** @type {Target} */ (this.closed);
    const camera = /** @type {Camera} */ (this.camera);
    const [albedo, depth, normal] = this.surfaces[this.turn].textures;
    const previous = this.shaded[1 - this.turn];
    const hasState = rests && this.tableContent === table;
    this.#use(programs.close, closed, { inverse_depth: depth, normal });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    const tableTexture = this.#loadTable(table);
    const [closedDepth, closedNormal] = closed.textures;
    const textures = { closed_depth: closedDepth, closed_normal: closedNormal, albedo, table: tableTexture };
    this.#use(programs.picture, this.shaded[this.turn], { ...textures, line_state: previous.textures[1] });
    const values = viewStyle(style, camera, this.focus, background);
    programs.picture.floats(values.floats);
    programs.picture.integers({ ...values.integers, has_state: hasState });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    return this.#drawLines(values);
  }

  /**
   * Draws the lines over the shaded image.
   * @param {ReturnType<typeof viewStyle>} values
   */
  #drawLines({ floats, integers }) {
    const { gl, programs } = this;
    const picture = /** @type {Target} */ (this.picture);
    const [shaded, lines] = this.shaded[this.turn].textures;
    this.#use(programs.outlines, picture, { shaded, lines });
    const { line_opacity, line_colour } = floats;
    programs.outlines.floats({ line_opacity, line_colour });
    programs.outlines.integers({ thickness: integers.thickness });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    return picture.textures[0];
  }

  /**
   * @param {Program} program
   * @param {Target} target
   * @param {Record<string, WebGLTexture>} textures Textures by sampler name.
   */
  #use(program, target, textures) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.framebuffer);
    gl.viewport(0, 0, target.width, target.height);
    program.use();
    Object.entries(textures).forEach(([name, texture], unit) => {
      bindTexture(gl, unit, texture);
      program.integers({ [name]: unit });
    });
  }

  /**
   * @param {number} width
   * @param {number} height
   */
  #resize(width, height) {
    const { gl } = this;
    if (this.closed && this.closed.width === width && this.closed.height === height) return;
    this.#releaseTargets();
    gl.activeTexture(gl.TEXTURE0); // Creating a texture binds it to the active unit.
    this.surfaces = [0, 1].map(() => new Target(gl, width, height, [gl.RGBA8, gl.R32F, gl.RGBA8]));
    this.shaded = [0, 1].map(() => new Target(gl, width, height, [gl.RGBA8, gl.R32UI]));
    this.picture = new Target(gl, width, height, [gl.RGBA8]);
    this.closed = new Target(gl, width, height, [gl.R32F, gl.RGBA8]);
    this.camera = null;
  }

  #releaseTargets() {
    for (const target of [...this.surfaces, ...this.shaded, this.closed, this.picture]) target?.release();
    this.surfaces = this.shaded = [];
    this.closed = this.picture = null;
  }

  /** @param {Uint8Array} content (rows, 256, 3) */
  #loadTable(content) {
    const { gl } = this;
    if (this.table && this.tableContent === content) return this.table;
    gl.deleteTexture(this.table);
    gl.activeTexture(gl.TEXTURE0);
    const rows = content.length / (3 * TONES);
    const table = makeTexture(gl, gl.RGB8, TONES, rows);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, TONES, rows, gl.RGB, gl.UNSIGNED_BYTE, content);
    this.table = table;
    this.tableContent = content;
    return table;
  }
}

/**
 * @param {Camera} first
 * @param {Camera} second
 */
function isSameCamera(first, second) {
  const names = /** @type {const} */ (["intrinsics", "rotation", "translation"]);
  return names.every((name) => first[name].every((value, index) => value === second[name][index]));
}
