import { inflateExactly } from "../decode/inflate.js";
import { SceneError } from "../scene/errors.js";

/**
 * A style, as viewer/publish/styles.py writes it. The numbers that depend on the camera are missing, because the player
 * computes them. Lengths are in pixels of an image with 1080 rows.
 * @typedef {object} Style
 * @property {string} name
 * @property {number[]} light Unit vector towards the light.
 * @property {"camera" | "world"} light_frame Axes of `light`.
 * @property {[number, number, number] | null} paper Colour of the paper, or null for the player's background.
 * @property {number} persistence
 * @property {number} thickness
 * @property {number} hatch_spacing
 * @property {number} detail_per_distance Detail per depth, where depth is in units of the distance from the camera to
 *   the focus.
 * @property {number} detail_axis
 * @property {number} line_filter
 * @property {Record<string, number | number[]>} numbers Uniforms that are the same for all cameras.
 * @property {number} rows Number of rows in the shade table.
 * @property {string} table The shade table, (rows, 256, 3) uint8, compressed with zlib and encoded in base64.
 */

/** @typedef {{styles: Style[]}} StyleFile */

const TONES = 256;
const NUMBER_NAMES = /** @type {const} */ (["persistence", "thickness", "hatch_spacing", "detail_axis", "line_filter", "rows"]);

/**
 * Loads the styles of a page.
 * @param {URL} url
 * @returns {Promise<StyleFile>}
 */
export async function loadStyles(url) {
  const response = await fetch(url, { cache: "no-cache" });
  if (!response.ok) {
    throw new SceneError(`${url.href}: expected the styles of the player, got status ${response.status}; use fourd web`);
  }
  /** @type {any} */
  const content = await response.json().catch(() => null);
  const styles = content?.styles;
  if (!Array.isArray(styles) || !styles.every(isStyle)) {
    throw new SceneError(`${url.href}: expected the styles of the player, got other content; write the site again`);
  }
  return content;
}

/** @param {any} style */
function isStyle(style) {
  return typeof style?.name === "string" && NUMBER_NAMES.every((name) => Number.isFinite(style[name]));
}

/**
 * Decompresses the shade table of a style.
 * @param {Style} style
 * @returns {Promise<Uint8Array>} (rows, 256, 3)
 */
export function readTable(style) {
  const compressed = Uint8Array.from(atob(style.table), (letter) => letter.charCodeAt(0));
  return inflateExactly(compressed, style.rows * TONES * 3, `style ${style.name}`);
}
