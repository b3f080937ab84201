import { Discs } from "./discs.js";
import { FrameTextures } from "./frame_textures.js";
/** @typedef {import("../scene/manifest.js").Manifest} Manifest */
/** @typedef {import("../scene/manifest.js").Camera} Camera */
/** @typedef {import("./frame_textures.js").Cloud} Cloud */

/**
 * The content of an image to draw: points, camera, and blending settings.
 * @typedef {object} Picture
 * @property {(Cloud | null)[]} clouds Dynamic points and background.
 * @property {Uint8Array | null} shadow Factors (M,), in units of 1/128, that multiply the colours of the M background
 *   points.
 * @property {import("../sort/sorter.js").SortedPoints} order
 * @property {Camera} camera The image has the size of this camera.
 * @property {{views: number[], weights: number[]}} selection Source views and their view weights.
 * @property {number} layers K, the maximum number of points that are composited per pixel.
 */

/** The points of a picture on the GPU, projected and shaded. */
export class ProjectedPoints {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {Manifest} manifest
   */
  constructor(gl, manifest) {
    this.textures = new FrameTextures(gl, manifest);
    this.discs = new Discs(gl, manifest);
  }

  /**
   * Uploads the arrays that have changed, and projects the points to the picture's camera.
   * @param {Picture} picture
   */
  project(picture) {
    const { views, weights } = picture.selection;
    const layers = this.textures.load(picture.clouds, picture.shadow, views);
    const loaded = views.map((view, index) => ({ layer: layers.get(view), weight: weights[index] }));
    const usable = /** @type {{layer: number, weight: number}[]} */ (loaded.filter(({ layer }) => layer !== undefined));
    // If no selected view is loaded, points are drawn in their mean colours, which are in layer 0.
    const blended = usable.length ? usable : views.length ? [{ layer: 0, weight: 1 }] : [];
    this.discs.project(
      this.textures,
      picture.order,
      picture.camera,
      { layers: blended.map(({ layer }) => layer), weights: blended.map(({ weight }) => weight) },
      picture.shadow !== null,
    );
  }

  release() {
    this.textures.release();
    this.discs.release();
  }
}
