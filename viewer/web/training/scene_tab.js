import { Refusal, fetchScene } from "./client.js";
import { buttonById, byId, setText } from "./elements.js";

const POLL_MS = 2000;
/** Times between requests in milliseconds while a scene is being baked. */
const BAKING_POLL_MS = 500;
/** Shares of the time at which the kinds of work begin and end. @type {Record<string, [number, number]>} */
const SHARES = { export: [0, 0.6], sample: [0.6, 0.7], pack: [0.7, 1] };

/** The tab with the player. The scene is baked and loaded only while the tab is shown. */
export class SceneTab {
  constructor() {
    this.buttons = { training: buttonById("show-training"), scene: buttonById("show-scene") };
    this.panes = { training: byId("training"), scene: byId("scene") };
    this.note = byId("scene-note");
    this.bar = /** @type {HTMLProgressElement} */ (byId("scene-progress"));
    this.isShown = false;
    /** Whether the player loads its first image. */
    this.isLoading = false;
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
    let delay = POLL_MS;
    try {
      const scene = await fetchScene();
      this.#showProgress(scene);
      if (scene.state === "baking") delay = BAKING_POLL_MS;
      if (scene.step >= 0 && this.isShown) await this.#showPlayer();
      setText(this.note, describe(scene, this.isLoading));
    } catch (error) {
      if (!(error instanceof Refusal)) throw error;
      setText(this.note, error.message);
    } finally {
      clearTimeout(this.timer);
      this.timer = setTimeout(() => this.#follow(), delay);
    }
  }

  /** @param {import("./client.js").SceneState} scene */
  #showProgress({ state, step, progress }) {
    // The player has room for a line of text only. The bar is for the minutes before the first scene.
    this.bar.hidden = state !== "baking" || step >= 0;
    if (progress) this.bar.value = shareOf(progress);
    else this.bar.removeAttribute("value");
  }

  async #showPlayer() {
    await import("../fourd-player.js");
    if (!this.isShown || this.panes.scene.querySelector("fourd-player")) return;
    const player = document.createElement("fourd-player");
    for (const name of ["autoplay", "links", "live"]) player.setAttribute(name, "");
    player.setAttribute("src", "scene.4dv");
    this.isLoading = true;
    for (const name of ["ready", "error"]) player.addEventListener(name, () => this.#endLoading(), { once: true });
    this.panes.scene.append(player);
  }

  #endLoading() {
    this.isLoading = false;
    this.#follow();
  }
}

/**
 * Share of the whole work, from 0 to 1.
 * @param {{work: string, done: number, count: number}} progress
 */
function shareOf({ work, done, count }) {
  const [from, to] = SHARES[work] ?? [0, 1];
  return from + ((to - from) * done) / Math.max(count, 1);
}

/**
 * @param {import("./client.js").SceneState} scene
 * @param {boolean} isLoading
 */
function describe(scene, isLoading) {
  const step = scene.step.toLocaleString("en");
  const loaded = isLoading ? `Loading the scene of step ${step} …` : `Scene of step ${step}.`;
  const shown = scene.step < 0 ? "" : loaded;
  if (scene.state === "baking") {
    const percent = scene.progress ? ` (${Math.floor(100 * shareOf(scene.progress))}%)` : "";
    return `${shown} The scene of the newest checkpoint is being made …${percent}`.trim();
  }
  if (scene.state === "failed") return `${shown} ${scene.message}`.trim();
  return shown || "The run has no checkpoint yet. The scene appears when the first checkpoint is saved.";
}
