import { SPEEDS } from "./panel.js";
/** @typedef {import("../fourd-player.js").FourdPlayer} FourdPlayer */

/**
 * Handles keyboard shortcuts. The keys for playback and cameras are the same as in the viewer's window.
 * @param {FourdPlayer} player
 */
export function addShortcuts(player) {
  /** @type {Record<string, () => void>} */
  const actions = {
    Space: () => player.togglePlay(),
    ArrowLeft: () => step(player, -1),
    ArrowRight: () => step(player, 1),
    Home: () => player.seek(0),
    End: () => player.seek((player.stage?.clock.frames ?? 1) - 1),
    BracketLeft: () => changeSpeed(player, -1),
    BracketRight: () => changeSpeed(player, 1),
    KeyN: () => changeCamera(player, 1),
    KeyP: () => changeCamera(player, -1),
    Digit0: () => player.moveToInitialView(),
    KeyL: () => player.panel.loop.click(),
    KeyM: () => player.soundButton.toggle(),
    KeyF: () => player.toggleFullScreen(),
    KeyC: () => player.copyLink(),
    KeyI: () => player.saveImage(),
    KeyK: () => player.cameraPath.add(),
    KeyY: () => player.cameraPath.toggle(),
    KeyT: () => nextStyle(player),
    KeyH: () => toggleHelp(player),
    F1: () => toggleHelp(player),
    "?": () => toggleHelp(player),
    Escape: () => (player.panel.help.hidden = true),
  };
  player.addEventListener("keydown", (event) => {
    // The question mark is another key on each keyboard layout.
    const action = actions[event.key === "?" ? "?" : event.code];
    if (!action || event.ctrlKey || event.altKey || event.metaKey) return;
    // Buttons, lists and the time bar handle their keys themselves.
    const target = event.composedPath()[0];
    const isSpace = event.code === "Space" && target instanceof HTMLButtonElement;
    const isArrow = event.code.startsWith("Arrow") && target instanceof HTMLSelectElement;
    if (isSpace || isArrow || (target instanceof HTMLInputElement && event.code !== "Space")) return;
    event.preventDefault();
    action();
  });
}

/**
 * @param {FourdPlayer} player
 * @param {number} frames
 */
function step(player, frames) {
  const clock = player.stage?.clock;
  if (clock) player.seek((clock.frame + frames + clock.frames) % clock.frames);
}

/**
 * @param {FourdPlayer} player
 * @param {number} direction
 */
function changeSpeed(player, direction) {
  const clock = player.stage?.clock;
  if (clock) clock.speed = SPEEDS[SPEEDS.indexOf(clock.speed) + direction] ?? clock.speed;
}

/**
 * @param {FourdPlayer} player
 * @param {number} direction
 */
function changeCamera(player, direction) {
  const order = [...player.panel.camera.options].map((option) => option.value).filter((value) => value !== "");
  if (order.length === 0) return;
  const now = order.indexOf(String(player.cameraIndex));
  const next = now < 0 && direction < 0 ? order.length - 1 : (now + direction + order.length) % order.length;
  player.moveToCamera(Number(order[next]));
}

/** @param {FourdPlayer} player */
function nextStyle(player) {
  const { list, name } = player.styleMenu;
  if (list.hidden) return;
  const names = [...list.options].map((option) => option.value);
  player.styleMenu.choose(names[(names.indexOf(name) + 1) % names.length]);
}

/** @param {FourdPlayer} player */
function toggleHelp(player) {
  player.panel.help.hidden = !player.panel.help.hidden;
}
