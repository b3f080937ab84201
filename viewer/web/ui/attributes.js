/**
 * Returns the colour that an attribute names, with components from 0 to 1.
 * @param {string | null} text A colour such as #203040.
 * @returns {[number, number, number] | null} Null for another text.
 */
export function parseColour(text) {
  const digits = /^#([0-9a-f]{2})([0-9a-f]{2})([0-9a-f]{2})$/i.exec(text ?? "");
  if (!digits) return null;
  return [parseInt(digits[1], 16) / 255, parseInt(digits[2], 16) / 255, parseInt(digits[3], 16) / 255];
}

/** Whether the user has asked the system for less motion. */
export function prefersStillness() {
  return matchMedia("(prefers-reduced-motion: reduce)").matches;
}
