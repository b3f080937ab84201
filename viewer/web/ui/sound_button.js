import { setIcon } from "./icons.js";
/** @typedef {import("../fourd-player.js").FourdPlayer} FourdPlayer */

/**
 * The button that switches the sound on and off. Sound is off at first, as browsers demand. Pressing Play switches it on,
 * unless the user has switched it off or the player has the attribute `muted`.
 */
export class SoundButton {
  /** @param {FourdPlayer} player */
  constructor(player) {
    this.player = player;
    /** What the user has chosen, or null. @type {boolean | null} */
    this.chosen = null;
    this.told = "";
    player.panel.sound.addEventListener("click", () => this.toggle());
    for (const name of ["pointerdown", "keydown"]) player.addEventListener(name, () => this.#sound?.resume());
  }

  /** Switches the sound on or off. */
  toggle() {
    if (!this.#sound) return;
    this.chosen = !this.#sound.isOn;
    this.#sound.setOn(this.chosen);
  }

  /** Switches the sound on, because the user has pressed Play, unless it is not wanted. */
  play() {
    if (this.chosen ?? !this.player.hasAttribute("muted")) this.#sound?.setOn(true);
  }

  /** Shows the state of the sound. Called once per displayed image. */
  show() {
    const { panel } = this.player;
    const sound = this.#sound;
    panel.sound.hidden = !sound;
    panel.bar.classList.toggle("with-sound", sound !== null);
    if (!sound) return;
    setIcon(panel.sound, sound.isOn ? "sound" : "muted");
    panel.sound.setAttribute("aria-pressed", String(sound.isOn));
    if (sound.problem && this.told !== sound.problem) panel.showNote(sound.problem);
    this.told = sound.problem;
  }

  get #sound() {
    return this.player.stage?.playback.sound ?? null;
  }
}
