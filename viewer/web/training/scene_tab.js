import { Refusal, fetchScene } from "./client.js";
import { buttonById, byId, setText } from "./elements.js";

const POLL_MS = 2000;

/** The tab with the player. The scene is baked and loaded only while the tab is shown. */
export class SceneTab {
  constructor() {
    this.buttons = { training: buttonById("show-training"), scene: buttonById("show-scene") };
    this.panes = { training: byId("training"), scene: byId("scene") };
    this.note = byId("scene-note");
    this.isShown = false;
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.timer = undefined;
    this.buttons.training.addEventListener("click", () => this.#select(false));
    this.buttons.scene.addEventListener("click", () => this.#select(true));
    document.addEventListener("visibilitychange", () => this.#follow());
    this.#select(new URLSearchParams(location.search).get("tab") === "scene");
  }

  /** @param {boolean} isScene */
  #select(isScene) {
    this.isShown = isScene;
    this.panes.scene.hidden = !isScene;
    this.panes.training.hidden = isScene;
    this.buttons.scene.setAttribute("aria-pressed", String(isScene));
    this.buttons.training.setAttribute("aria-pressed", String(!isScene));
    const address = new URL(location.href);
    if (isScene) address.searchParams.set("tab", "scene");
    else address.searchParams.delete("tab");
    history.replaceState(null, "", address);
    if (!isScene) this.panes.scene.querySelector("fourd-player")?.remove();
    this.#follow();
  }

  async #follow() {
    clearTimeout(this.timer);
    if (!this.isShown || document.hidden) return;
    try {
      const scene = await fetchScene();
      setText(this.note, describe(scene));
      if (scene.step >= 0 && this.isShown) await this.#showPlayer();
    } catch (error) {
      if (!(error instanceof Refusal)) throw error;
      setText(this.note, error.message);
    } finally {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.#follow(), POLL_MS);
    }
  }

  async #showPlayer() {
    await import("../fourd-player.js");
    if (!this.isShown || this.panes.scene.querySelector("fourd-player")) return;
    const player = document.createElement("fourd-player");
    for (const name of ["autoplay", "links", "live"]) player.setAttribute(name, "");
    player.setAttribute("src", "scene.4dv");
    this.panes.scene.append(player);
  }
}

/** @param {import("./client.js").SceneState} scene */
function describe(scene) {
  const shown = scene.step < 0 ? "" : `Scene of step ${scene.step.toLocaleString("en")}.`;
  if (scene.state === "baking") return `${shown} The scene of the newest checkpoint is being baked …`.trim();
  if (scene.state === "failed") return `${shown} ${scene.message}`.trim();
  return shown || "The run has no checkpoint yet. The scene appears when the first checkpoint is saved.";
}
