import { frameFolder } from "./manifest.js";
/** @typedef {import("./manifest.js").Manifest} Manifest */
/** @typedef {import("./manifest.js").CloudEncoding} CloudEncoding */

/** The number that identifies the background. Frames have the numbers 0, 1, 2, ... */
export const BACKGROUND = -1;
/** The member with the sound, Opus in an Ogg file. */
export const SOUND = "sound.ogg";

/**
 * Returns the folder, the number of points and the encoding of a frame or of the background.
 * @param {Manifest} manifest
 * @param {number} number
 */
export function describeCloud(manifest, number) {
  if (number === BACKGROUND) {
    const encoding = /** @type {CloudEncoding} */ (manifest.backgroundEncoding);
    return { folder: "background", points: manifest.background?.points ?? 0, encoding };
  }
  return { folder: frameFolder(number), points: manifest.points[number], encoding: manifest.dynamicEncoding };
}

/**
 * Returns the names of the members that are needed to draw a cloud with mean colours.
 * @param {Manifest} manifest
 * @param {number} number
 */
export function baseMembers(manifest, number) {
  const { folder } = describeCloud(manifest, number);
  return {
    points: `${folder}/points`,
    sh: `${folder}/sh`,
    colour: manifest.sources.length ? `${folder}/colour` : null,
    shadow: number !== BACKGROUND && manifest.background?.shadow ? `${folder}/shadow` : null,
  };
}

/**
 * Returns the name of the member with the normals, which styles need.
 * @param {Manifest} manifest
 * @param {number} number
 */
export function normalsMember(manifest, number) {
  return `${describeCloud(manifest, number).folder}/optional/normals`;
}

/**
 * Returns the name of the member with the colours of a source view.
 * @param {Manifest} manifest
 * @param {number} number
 * @param {number} view
 */
export function viewMember(manifest, number, view) {
  return `${describeCloud(manifest, number).folder}/views/${String(view).padStart(3, "0")}`;
}
