import { dot, row } from "../navigate/math.js";
import { FULL_SCREEN_VERTEX } from "../shaders/fullscreen.vert.js";
import { SortedCompositor } from "./compositors.js";
import { bindTexture, makeProgram, setInitialState } from "./gl.js";
import { HOST_COLOUR_FRAGMENT, HOST_DEPTH, HOST_DEPTH_FRAGMENT, HOST_DISC_FRAGMENT } from "./host_shaders.js";
/** @typedef {import("../scene/manifest.js").Manifest} Manifest */
/** @typedef {import("./projected_points.js").Picture} Picture */
/** @typedef {import("./projected_points.js").ProjectedPoints} ProjectedPoints */

/**
 * Describes where an image is drawn in the framebuffer of another program (the host).
 * @typedef {object} HostTarget
 * @property {WebGLFramebuffer | null} framebuffer Null stands for the canvas.
 * @property {[number, number]} corner Framebuffer pixel (x, y) at the image's bottom left corner.
 * @property {[number, number]} depthRange Numbers a and b, with which a point at depth z has the depth a + b / z in
 *   normalised device coordinates.
 * @property {WebGLTexture | null} depthTexture Depth of the host's objects, with one texel per pixel of the
 *   framebuffer.
 * @property {boolean} writesDepth
 */

/** Draws images over the content of another program's framebuffer, with correct occlusion. */
export class HostRenderer {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {Manifest} manifest
   * @param {ProjectedPoints} points The caller must release them.
   */
  constructor(gl, manifest, points) {
    this.gl = gl;
    this.manifest = manifest;
    this.points = points;
    this.colour = makeProgram(gl, FULL_SCREEN_VERTEX, HOST_COLOUR_FRAGMENT);
    this.depth = makeProgram(gl, FULL_SCREEN_VERTEX, HOST_DEPTH_FRAGMENT);
    this.emptyArray = gl.createVertexArray();
    /** Compositors by number of outputs, which is 1 for colour, or 2 for colour and depth. @type {Map<number,
     * SortedCompositor>} */
    this.compositors = new Map();
  }

  /**
   * Composites a picture over the target.
   * @param {Picture} picture
   * @param {HostTarget} target
   */
  draw(picture, target) {
    const { gl } = this;
    if (gl.isContextLost()) return;
    setInitialState(gl);
    this.points.project(picture);
    const { width, height } = picture.camera;
    const top = [target.corner[0], target.corner[1] + height - 1];
    const depth = { depth_range: target.depthRange, unit_depth: this.#distanceToFocus(picture) };
    bindTexture(gl, 1, target.depthTexture);
    gl.activeTexture(gl.TEXTURE0); // Creating a texture binds it to the active unit.
    const images = this.#compositor(target.writesDepth ? 2 : 1).drawAll(
      width,
      height,
      picture.layers,
      { host_depth: 1, tests_depth: target.depthTexture !== null },
      { ...depth, host_corner: top },
    );
    bindTexture(gl, 1, null);
    gl.bindFramebuffer(gl.FRAMEBUFFER, target.framebuffer);
    gl.viewport(target.corner[0], target.corner[1], width, height);
    gl.bindVertexArray(this.emptyArray);
    this.#drawColour(images[0], top);
    if (target.writesDepth) this.#drawDepth(images[1], { ...depth, corner: top, pixel_filter: this.manifest.pixelFilter });
    gl.bindVertexArray(null);
    gl.useProgram(null);
  }

  /** Deletes all WebGL objects that the renderer has created. */
  release() {
    for (const compositor of this.compositors.values()) compositor.release();
    for (const program of [this.colour, this.depth]) program.release();
    this.gl.deleteVertexArray(this.emptyArray);
  }

  /** @param {number} outputs */
  #compositor(outputs) {
    let compositor = this.compositors.get(outputs);
    if (!compositor) {
      const options = { fragment: HOST_DISC_FRAGMENT, depth: HOST_DEPTH, outputs };
      compositor = new SortedCompositor(this.gl, this.points.discs, options);
      this.compositors.set(outputs, compositor);
    }
    return compositor;
  }

  /** @param {Picture} picture */
  #distanceToFocus({ camera }) {
    const along = dot(row(camera.rotation, 2), this.manifest.focus) + camera.translation[2];
    return Math.max(Math.abs(along), this.manifest.near);
  }

  /**
   * @param {WebGLTexture} image
   * @param {number[]} corner
   */
  #drawColour(image, corner) {
    const { gl, colour } = this;
    gl.disable(gl.DEPTH_TEST);
    gl.depthMask(false);
    gl.enable(gl.BLEND);
    gl.blendEquation(gl.FUNC_ADD);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    bindTexture(gl, 0, image);
    colour.use();
    colour.integers({ image: 0 });
    colour.floats({ corner, pixel_filter: this.manifest.pixelFilter });
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.disable(gl.BLEND);
    gl.depthMask(true);
  }

  /**
   * @param {WebGLTexture} image
   * @param {Record<string, number | number[]>} uniforms
   */
  #drawDepth(image, uniforms) {
    const { gl, depth } = this;
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.colorMask(false, false, false, false);
    bindTexture(gl, 0, image);
    depth.use();
    depth.integers({ weighted_depth: 0 });
    depth.floats(uniforms);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.colorMask(true, true, true, true);
    gl.disable(gl.DEPTH_TEST);
  }
}
