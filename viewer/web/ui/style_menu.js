import { SceneError, describeError } from "../scene/errors.js";
import { loadStyles, readTable } from "../stylize/style_file.js";
/** @typedef {import("../fourd-player.js").FourdPlayer} FourdPlayer */

const NONE = "none";
const URL_OF_STYLES = new URL("../stylize.json", import.meta.url);

/** Applies the style that the user selects in the list, or that the attribute `stylize` names. */
export class StyleMenu {
  /** @param {FourdPlayer} player */
  constructor(player) {
    this.player = player;
    /** @type {import("../stylize/style_file.js").StyleFile | null} */
    this.file = null;
    /** Name of the style that was set last, by the user or by the attribute. */
    this.name = NONE;
    this.list.hidden = true;
    this.list.addEventListener("change", () => this.choose(this.list.value));
  }

  /** @returns {HTMLSelectElement} */
  get list() {
    return this.player.panel.styles;
  }

  /** Applies the style that the attribute names. Called when the attribute changes, and when a scene is opened. */
  async follow() {
    const name = this.player.getAttribute("stylize") ?? this.name;
    if (name !== NONE || this.file) await this.choose(name);
  }

  /** Shows the list of the page's styles, or leaves it hidden if the page has none. */
  async offer() {
    await this.#load().catch(() => {});
  }

  /**
   * Draws the scene in a style. If this fails, a note is shown, and the scene is drawn without a style.
   * @param {string} name
   */
  async choose(name) {
    this.name = name;
    const { stage } = this.player;
    if (!stage) return;
    try {
      const ready = name === NONE ? null : await this.#prepare(name, stage);
      if (stage !== this.player.stage || name !== this.name) return;
      stage.setStyle(ready);
    } catch (error) {
      if (stage !== this.player.stage || name !== this.name) return;
      this.name = NONE;
      stage.setStyle(null);
      this.player.panel.showNote(describeError(error));
    }
    this.list.value = this.name;
  }

  /**
   * @param {string} name
   * @param {import("../play/stage.js").Stage} stage
   * @returns {Promise<import("../stylize/styled_drawing.js").ReadyStyle>}
   */
  async #prepare(name, stage) {
    const { styles } = await this.#load();
    const style = styles.find((each) => each.name === name);
    if (!style) {
      const names = [NONE, ...styles.map((each) => each.name)].join(", ");
      throw new SceneError(`stylize: expected ${names}, got '${name}'; correct the attribute`);
    }
    if (!stage.manifest.hasNormals) {
      throw new SceneError("The scene has no normals, which styles need; write the page again with fourd web");
    }
    if (!stage.renderer?.gl.getExtension("EXT_color_buffer_float")) {
      throw new SceneError("WebGL: expected the extension EXT_color_buffer_float for styles, got none; use a newer browser");
    }
    const drawn = this.player.ownBackground ? { ...style, paper: null } : style;
    return { style: drawn, table: await readTable(style) };
  }

  async #load() {
    if (this.file) return this.file;
    const file = await loadStyles(URL_OF_STYLES);
    if (!this.file) {
      this.file = file;
      const options = file.styles.map(({ name }) => new Option(name, name));
      this.list.replaceChildren(new Option("No style", NONE), ...options);
      this.list.value = this.name;
      this.list.hidden = false;
    }
    return this.file;
  }
}
