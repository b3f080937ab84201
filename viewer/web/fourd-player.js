import { DecodePool } from "./decode/pool.js";
import { Controls } from "./navigate/controls.js";
import { estimateUp, poseFromCamera } from "./navigate/pose.js";
import { fromFragment, toFragment } from "./navigate/share_link.js";
import { DEFAULT_BACKGROUND, Stage } from "./play/stage.js";
import { ByteSource } from "./scene/byte_source.js";
import { ChangedError, SceneError, describeError } from "./scene/errors.js";
import { SceneFile } from "./scene/scene_file.js";
import { parseColour, prefersStillness } from "./ui/attributes.js";
import { Panel } from "./ui/panel.js";
import { PathControls } from "./ui/path_controls.js";
import { addShortcuts } from "./ui/shortcuts.js";
import { SoundButton } from "./ui/sound_button.js";
import { StyleMenu } from "./ui/style_menu.js";
import { STYLE } from "./ui/style.js";
import { VrSession, supportsVr } from "./xr/vr_session.js";
/** @typedef {import("./navigate/pose.js").Pose} Pose */

const SPINNER_DELAY_MS = 300;
const QUIET_MS = 3000;
/** Interval in milliseconds between checks for a changed scene on the server. */
const LIVE_MS = 2000;

/** State that an element keeps when it opens a changed version of its scene.
 * @typedef {{pose: Pose, seconds: number, isPlaying: boolean}} Kept */

/**
 * The element `<fourd-player src="scene.4dv">`, which plays a packed scene.
 *
 * Attributes: `src`, `poster` (image that is shown first), `autoplay`, `controls="none"` (no buttons), `muted` (Play does
 * not switch the sound on), `background` (a colour such as #203040), `stylize` (name of a style), `mode="reference"`
 * (exact depth peeling), `links` (the page's address contains the view and the time), `timeout` (seconds without data
 * after which a request is repeated, 15 by default), `live` (the scene is opened again when it changes on the server),
 * `embedded` (the element is a part of a page that scrolls).
 * Events: `ready` after the first image, and `error`.
 */
export class FourdPlayer extends HTMLElement {
  static observedAttributes = ["src", "stylize", "background"];

  constructor() {
    super();
    const root = this.attachShadow({ mode: "open" });
    const sheet = new CSSStyleSheet();
    sheet.replaceSync(STYLE);
    root.adoptedStyleSheets = [sheet];
    this.panel = new Panel(root);
    /** @type {Stage | null} */
    this.stage = null;
    /** @type {DecodePool | null} */
    this.pool = null;
    /** @type {VrSession | null} */
    this.vr = null;
    /** Returns where the scene's bytes come from. Programs with another connection than HTTP replace this function.
     * @type {(url: string, stallMs: number) => import("./scene/scene_file.js").Source} */
    this.makeSource = (url, stallMs) => new ByteSource(new URL(url, document.baseURI).href, stallMs);
    this.generation = 0;
    this.cameraIndex = -1;
    /** @type {Pose | null} */
    this.initialPose = null;
    this.lastInput = performance.now();
    /** Time from the start of loading to the first image, in milliseconds. */
    this.firstImageMs = 0;
    /** Whether a part of the element is in the window. Otherwise, the scene neither plays nor draws. */
    this.isInView = true;
    this.styleMenu = new StyleMenu(this);
    this.cameraPath = new PathControls(this);
    this.soundButton = new SoundButton(this);
    this.controls = new Controls(this.panel.canvas, this, () => this.stage?.pose ?? null, (pose) => this.stage?.setPose(pose));
    /** Shows the view of a link that the user opens in the page that is already open. */
    this.followLink = () => this.#follow(location.hash);
    this.#listen();
    addShortcuts(this);
  }

  connectedCallback() {
    if (!this.hasAttribute("tabindex")) this.tabIndex = 0;
    if (!this.hasAttribute("role")) this.setAttribute("role", "group");
    if (!this.hasAttribute("aria-label")) this.setAttribute("aria-label", "4D scene");
    this.panel.bar.hidden = this.getAttribute("controls") === "none";
    supportsVr().then((supported) => (this.panel.vr.hidden = !supported));
    const poster = this.getAttribute("poster");
    if (poster) Object.assign(this.panel.poster, { src: poster, hidden: false });
    this.observer = new ResizeObserver(() => this.#resize());
    this.observer.observe(this);
    this.inView = new IntersectionObserver((entries) => (this.isInView = entries[entries.length - 1].isIntersecting));
    this.inView.observe(this);
    if (this.hasAttribute("links")) window.addEventListener("hashchange", this.followLink);
    if (this.hasAttribute("live")) this.liveTimer = setInterval(() => this.#openIfChanged(), LIVE_MS);
    // The keys work at once in a page whose address belongs to the player. In other pages, the reader chooses the player.
    const hasFocus = document.activeElement !== document.body;
    if (this.hasAttribute("links") && !hasFocus) this.focus({ preventScroll: true });
    this.#open();
  }

  disconnectedCallback() {
    this.observer?.disconnect();
    this.inView?.disconnect();
    clearInterval(this.liveTimer);
    window.removeEventListener("hashchange", this.followLink);
    this.#close();
  }

  /** @param {string} name */
  attributeChangedCallback(name) {
    if (!this.isConnected) return;
    if (name === "src") this.#open();
    else if (name === "stylize") this.styleMenu.follow();
    else if (this.stage) this.#setBackground(this.stage);
  }

  /** The background that the attribute names, which replaces the paper of styles; null if there is none. */
  get ownBackground() {
    return parseColour(this.getAttribute("background"));
  }

  /** Resolves when the image shows the current time and view at full resolution. */
  async settled() {
    while (!this.stage?.isSettled) {
      if (!this.panel.message.hidden && !this.panel.message.classList.contains("note")) {
        throw new SceneError(this.panel.message.textContent ?? "");
      }
      await new Promise((resolve) => setTimeout(resolve, 5));
    }
  }

  /** Moves the view to a camera of the capture.
   * @param {number} index
   */
  moveToCamera(index) {
    const { stage } = this;
    const camera = stage?.manifest.cameras[index];
    if (!stage || !camera) return;
    const { width, height } = this.panel.canvas;
    this.cameraIndex = index;
    this.panel.camera.value = String(index);
    stage.setPose(poseFromCamera(camera, stage.manifest.focus, estimateUp(stage.manifest.cameras), width, height));
  }

  moveToInitialView() {
    if (this.initialPose) this.stage?.setPose(this.initialPose);
  }

  togglePlay() {
    this.stage?.store.retry();
    this.stage?.clock.toggle();
    if (this.stage?.clock.isPlaying) this.soundButton.play();
  }

  /**
   * Seeks to a frame and pauses there.
   * @param {number} frame
   */
  seek(frame) {
    if (!this.stage) return;
    this.stage.store.retry();
    this.stage.clock.isPlaying = false;
    this.stage.clock.seek(frame);
  }

  /** Returns a link to the current view and time. */
  get shareLink() {
    const link = new URL(location.href);
    if (this.stage) link.hash = toFragment(this.stage.pose, this.stage.clock.frame / this.stage.clock.fps);
    return link.href;
  }

  async copyLink() {
    const link = this.shareLink;
    history.replaceState(null, "", link);
    try {
      await navigator.clipboard.writeText(link);
      this.panel.showNote("The link to this view is copied.");
    } catch {
      this.panel.showNote("The address of the page contains this view.");
    }
  }

  /** Saves the image as a PNG file. */
  async saveImage() {
    this.stage?.redraw();
    const blob = await new Promise((resolve) => this.panel.canvas.toBlob(resolve, "image/png"));
    if (!blob) return;
    const anchor = document.createElement("a");
    anchor.href = URL.createObjectURL(blob);
    anchor.download = `frame_${String(this.stage?.clock.frame ?? 0).padStart(6, "0")}.png`;
    anchor.click();
    setTimeout(() => URL.revokeObjectURL(anchor.href), 10000);
  }

  toggleFullScreen() {
    const change = document.fullscreenElement ? document.exitFullscreen() : this.requestFullscreen();
    change.catch(() => this.panel.showNote("The browser does not allow full screen here."));
  }

  /** Starts or ends showing the scene in a headset. Browsers allow the start only while they handle a click. */
  async toggleVr() {
    if (this.vr) return this.vr.end();
    const { stage } = this;
    if (!stage?.renderer) return;
    try {
      this.vr = await VrSession.start(stage, (error) => {
        this.vr = null;
        if (error) this.#fail(error);
      });
      if (stage !== this.stage) this.vr.end();
    } catch (error) {
      this.panel.showNote(`The browser does not start VR: ${error instanceof Error ? error.message : error}`);
    }
  }

  #listen() {
    const { panel } = this;
    panel.play.addEventListener("click", () => this.togglePlay());
    panel.scrub.addEventListener("input", () => this.seek(Number(panel.scrub.value)));
    panel.speed.addEventListener("change", () => this.stage && (this.stage.clock.speed = Number(panel.speed.value)));
    panel.loop.addEventListener("click", () => this.stage && (this.stage.clock.loops = !this.stage.clock.loops));
    panel.camera.addEventListener("change", () => panel.camera.value && this.moveToCamera(Number(panel.camera.value)));
    panel.shoot.addEventListener("click", () => this.saveImage());
    panel.link.addEventListener("click", () => this.copyLink());
    panel.full.addEventListener("click", () => this.toggleFullScreen());
    panel.vr.addEventListener("click", () => this.toggleVr());
    panel.canvas.addEventListener("pointerdown", () => this.focus());
    for (const name of ["pointermove", "pointerdown", "keydown", "focusin"]) {
      this.addEventListener(name, () => (this.lastInput = performance.now()));
    }
    panel.canvas.addEventListener("webglcontextlost", (event) => {
      event.preventDefault();
      this.vr?.end();
      this.stage?.loseContext();
      panel.showError("The graphics driver was reset. The player waits for it.");
    });
    panel.canvas.addEventListener("webglcontextrestored", () => {
      this.stage?.restoreContext();
      panel.hideMessage();
    });
  }

  async #openIfChanged() {
    const { stage } = this;
    if (stage && (await stage.store.file.source.hasChanged()) && stage === this.stage) this.#openAgain();
  }

  #openAgain() {
    const { stage } = this;
    if (!stage) return;
    const { seconds, isPlaying } = stage.clock;
    this.#open({ pose: stage.pose, seconds, isPlaying });
  }

  /** @param {Kept} [kept] */
  async #open(kept) {
    this.#close();
    const src = this.getAttribute("src");
    if (!src) return;
    const generation = ++this.generation;
    const started = performance.now();
    this.panel.hideMessage();
    this.panel.spinner.hidden = false;
    try {
      const pool = new DecodePool();
      this.pool = pool;
      const seconds = Number(this.getAttribute("timeout")) || 15;
      const file = await SceneFile.open(this.makeSource(src, 1000 * seconds));
      if (generation !== this.generation) return pool.release();
      this.#start(file, pool, started, kept);
    } catch (error) {
      if (generation === this.generation) this.#fail(error);
    }
  }

  /**
   * @param {SceneFile} file
   * @param {DecodePool} pool
   * @param {number} started
   * @param {Kept} [kept]
   */
  #start(file, pool, started, kept) {
    const { manifest } = file;
    if (manifest.points.length === 0) throw new SceneError("The scene has no frames; export it again");
    if (manifest.cameras.length === 0) throw new SceneError("The scene has no cameras; export it again");
    this.#resize();
    const { width, height } = this.panel.canvas;
    const up = estimateUp(manifest.cameras);
    this.initialPose = poseFromCamera(manifest.cameras[0], manifest.focus, up, width, height);
    const stage = new Stage(this.panel.canvas, file, pool, this.initialPose, (error) => this.#fail(error));
    this.stage = stage;
    if (this.getAttribute("mode") === "reference") stage.mode = "reference";
    this.#setBackground(stage);
    this.panel.bar.hidden = this.getAttribute("controls") === "none";
    this.panel.setCameras(manifest.cameras.map((camera) => camera.name));
    if (this.hasAttribute("links")) this.#follow(location.hash);
    stage.clock.isPlaying = this.hasAttribute("autoplay") && !(this.hasAttribute("embedded") && prefersStillness());
    if (kept) {
      stage.setPose(kept.pose);
      stage.clock.seek(Math.round(kept.seconds * manifest.fps));
      stage.clock.isPlaying = kept.isPlaying;
    }
    this.styleMenu.follow();
    this.#run(stage, started);
  }

  /** @param {Stage} stage */
  #setBackground(stage) {
    stage.background = this.ownBackground ?? DEFAULT_BACKGROUND;
    stage.isDirty = true;
  }

  /**
   * Shows the view and the time of a link.
   * @param {string} fragment
   */
  #follow(fragment) {
    const { stage } = this;
    if (!stage) return;
    const { pose, seconds } = fromFragment(fragment, stage.pose.up);
    if (pose) stage.setPose(pose);
    if (seconds !== undefined) stage.clock.seek(Math.round(seconds * stage.manifest.fps));
  }

  /**
   * @param {Stage} stage
   * @param {number} started
   */
  #run(stage, started) {
    let last = performance.now();
    let waitingSince = last;
    const step = (/** @type {number} */ now) => {
      if (stage !== this.stage) return;
      const elapsed = Math.max(now - last, 0) / 1000;
      last = now;
      if (!this.isInView && !this.vr) {
        stage.playback.sound?.rest();
        requestAnimationFrame(step);
        return;
      }
      try {
        this.controls.update(elapsed);
        this.cameraPath.update(elapsed);
        stage.update(now, elapsed);
      } catch (error) {
        this.#fail(error);
        return;
      }
      if (stage.images === 1 && !this.firstImageMs) this.#announce(started);
      if (!stage.isWaiting) waitingSince = now;
      this.panel.spinner.hidden = now - waitingSince < SPINNER_DELAY_MS || !this.panel.message.hidden;
      this.panel.showTime(stage.clock);
      this.soundButton.show();
      this.classList.toggle("quiet", stage.clock.isPlaying && now - this.lastInput > QUIET_MS);
      requestAnimationFrame(step);
    };
    requestAnimationFrame(step);
  }

  /** @param {number} started */
  #announce(started) {
    this.firstImageMs = performance.now() - started;
    this.panel.poster.hidden = true;
    this.styleMenu.offer();
    this.dispatchEvent(new CustomEvent("ready"));
  }

  /** @param {unknown} error */
  #fail(error) {
    if (error instanceof DOMException && error.name === "AbortError") return;
    if (error instanceof ChangedError && this.hasAttribute("live")) {
      this.#openAgain();
      return;
    }
    this.panel.spinner.hidden = true;
    this.panel.showError(describeError(error));
    // Without an image, there is nothing that the controls could change, and the list of cameras is empty.
    if (!this.firstImageMs) this.panel.bar.hidden = true;
    if (this.stage) this.stage.clock.isPlaying = false;
    this.dispatchEvent(new CustomEvent("error", { detail: error }));
  }

  #close() {
    this.generation++;
    this.vr?.end();
    this.stage?.release();
    this.pool?.release();
    this.stage = this.pool = null;
    this.firstImageMs = 0;
  }

  #resize() {
    this.panel.arrange();
    const { canvas } = this.panel;
    const width = Math.max(Math.round(this.clientWidth * devicePixelRatio), 1);
    const height = Math.max(Math.round(this.clientHeight * devicePixelRatio), 1);
    if (canvas.width === width && canvas.height === height) return;
    canvas.width = width;
    canvas.height = height;
    if (this.stage) this.stage.isDirty = true;
  }
}

if (!customElements.get("fourd-player")) customElements.define("fourd-player", FourdPlayer);
