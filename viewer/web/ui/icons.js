/** Icons of the buttons, as paths in a square of 24 units. */
export const ICONS = {
  play: "M7 4v16l13-8z",
  pause: "M6 4h4v16H6zM14 4h4v16h-4z",
  loop: "M12 5V1L7 6l5 5V7a5 5 0 1 1-5 5H5a7 7 0 1 0 7-7z",
  sound: "M3 9h4l5-5v16l-5-5H3zM14 8.5a4 4 0 0 1 0 7zM14 4.3a8 8 0 0 1 0 15.4v-2.1a6 6 0 0 0 0-11.2z",
  muted: "M3 9h4l5-5v16l-5-5H3zM14.5 9l1.4-1.4 2.6 2.6 2.6-2.6L22.5 9l-2.6 2.6 2.6 2.6-1.4 1.4-2.6-2.6-2.6 2.6-1.4-1.4 2.6-2.6z",
  addKey: "M3 6h12v4l6-3v10l-6-3v4H3zM8 9v2H6v2h2v2h2v-2h2v-2h-2V9z",
  playPath: "M3 6h12v4l6-3v10l-6-3v4H3zM7 9v6l5-3z",
  stopPath: "M3 6h12v4l6-3v10l-6-3v4H3zM7 10v4h4v-4z",
  savePath: "M3 4h12v4l6-3v9l-6-3v3h-2V6H5v8H3zM8 8h2v6h3l-4 4-4-4h3zM3 20h12v2H3z",
  save: "M11 3h2v9h4l-5 5-5-5h4zM4 19h16v2H4z",
  link: "M8 7h3v2H8a3 3 0 0 0 0 6h3v2H8A5 5 0 0 1 8 7zM13 7h3a5 5 0 0 1 0 10h-3v-2h3a3 3 0 0 0 0-6h-3zM8 11h8v2H8z",
  more: "M4 10h4v4H4zM10 10h4v4h-4zM16 10h4v4h-4z",
  full: "M4 4h6v2H6v4H4zM14 4h6v6h-2V6h-4zM4 14h2v4h4v2H4zM18 14h2v6h-6v-2h4z",
  vr: "M3 7h18v10h-6l-2-3h-2l-2 3H3zM7 10v3h3v-3zM14 10v3h3v-3z",
  help: "M11 17h2v2h-2zM12 5a4 4 0 0 0-4 4h2a2 2 0 1 1 3 1.7c-1.3.8-2 1.7-2 3.3h2c0-.9.4-1.3 1.2-1.8A4 4 0 0 0 12 5z",
};

/** @typedef {keyof typeof ICONS} IconName */

const SVG = "http://www.w3.org/2000/svg";

/**
 * Sets the icon of a button.
 * @param {HTMLButtonElement} button
 * @param {IconName} name
 */
export function setIcon(button, name) {
  if (button.dataset.icon === name) return;
  button.dataset.icon = name;
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "0 0 24 24");
  svg.setAttribute("aria-hidden", "true");
  const path = document.createElementNS(SVG, "path");
  path.setAttribute("d", ICONS[name]);
  svg.append(path);
  button.replaceChildren(svg);
}
