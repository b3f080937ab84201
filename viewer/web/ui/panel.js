import { setIcon } from "./icons.js";

/** Playback speeds that the player offers. */
export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4];

const HELP = [
  ["drag, one finger", "orbit"],
  ["right or Shift + drag, two fingers", "pan"],
  ["wheel, Ctrl + drag, pinch", "move nearer or farther"],
  ["W A S D, Q, E", "fly; with Shift faster"],
  ["Space", "play or pause"],
  ["Left, Right", "previous frame, next frame"],
  ["Home, End", "first frame, last frame"],
  ["[ and ]", "play slower, play faster"],
  ["N, P", "next camera, previous camera"],
  ["0", "initial view"],
  ["L", "loop"],
  ["M", "sound on or off"],
  ["K", "add this view to the camera path"],
  ["Y", "play or stop the camera path"],
  ["T", "next style"],
  ["F", "full screen"],
  ["C", "copy a link to this view"],
  ["I", "save the image"],
  ["?, H, F1", "help"],
  ["Esc", "close the help"],
];
/** What fingers do, on screens without a mouse. */
const TOUCH_HELP = [
  ["one finger", "orbit"],
  ["two fingers", "pan"],
  ["pinch", "move nearer or farther"],
];

/** The elements of the player in its shadow tree: image, buttons and messages. */
export class Panel {
  /** @param {ShadowRoot} root */
  constructor(root) {
    this.canvas = document.createElement("canvas");
    this.poster = element("img", { className: "poster", alt: "", hidden: true });
    this.spinner = element("div", { className: "spinner", hidden: true });
    this.spinner.setAttribute("role", "status");
    this.spinner.setAttribute("aria-label", "Loading");
    this.message = element("div", { className: "message", hidden: true });
    this.message.setAttribute("role", "alert");
    this.help = makeHelp();
    this.play = button("play", "Play or pause (Space)");
    this.scrub = element("input", { type: "range", min: "0", max: "0", step: "1", value: "0", title: "Time" });
    this.scrub.setAttribute("aria-label", "Frame");
    this.time = element("span", { className: "time" });
    this.speed = list("Speed");
    for (const value of SPEEDS) this.speed.append(new Option(`${value}×`, String(value)));
    this.loop = button("loop", "Loop (L)");
    this.camera = list("Cameras of the capture");
    this.styles = list("Style");
    this.styles.hidden = true;
    this.shoot = button("save", "Save the image (I)");
    this.link = button("link", "Copy a link to this view (C)");
    this.link.classList.add("link");
    this.addKey = button("addKey", "Add this view to the camera path (K)");
    this.playPath = button("playPath", "Play or stop the camera path (Y)");
    this.savePath = button("savePath", "Save the camera path");
    this.full = button("full", "Full screen (F)");
    this.vr = button("vr", "Enter VR");
    this.vr.hidden = true;
    this.question = button("help", "Help (?)");
    this.bar = element("div", { className: "bar" });
    // Controls without room in a narrow player. The button `more` shows them in a row above the others.
    this.extra = element("div", { className: "extra", id: "extra" });
    this.extra.append(this.loop, this.speed, this.camera, this.styles, this.addKey, this.playPath, this.savePath);
    this.extra.append(this.shoot, this.link, this.question);
    this.sound = button("muted", "Sound (M)");
    this.sound.hidden = true;
    this.more = button("more", "More controls");
    this.more.classList.add("more");
    this.more.setAttribute("aria-controls", this.extra.id);
    this.#showExtra(false);
    this.more.addEventListener("click", () => {
      this.#showExtra(!this.bar.classList.contains("open"));
      // The row stands before the button in the order of the Tab key, as on the screen.
      if (this.bar.classList.contains("open")) this.loop.focus();
    });
    this.bar.append(this.play, this.scrub, this.time, this.sound, this.more, this.extra, this.full, this.vr);
    root.append(this.canvas, this.poster, this.spinner, this.bar, this.help, this.message);
    this.question.addEventListener("click", () => (this.help.hidden = !this.help.hidden));
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    this.noteTimer = undefined;
  }

  /**
   * Shows an error until the page is loaded again.
   * @param {string} text
   */
  showError(text) {
    clearTimeout(this.noteTimer);
    this.message.classList.remove("note");
    this.message.textContent = text;
    this.message.hidden = false;
  }

  /**
   * Shows a note for three seconds, unless an error is shown.
   * @param {string} text
   */
  showNote(text) {
    if (!this.message.hidden && !this.message.classList.contains("note")) return;
    this.message.classList.add("note");
    this.message.textContent = text;
    this.message.hidden = false;
    clearTimeout(this.noteTimer);
    this.noteTimer = setTimeout(() => (this.message.hidden = true), 3000);
  }

  hideMessage() {
    clearTimeout(this.noteTimer);
    this.message.hidden = true;
  }

  /** Puts the controls without room where the player shows them, because the Tab key follows the order of the elements. */
  arrange() {
    const isNarrow = getComputedStyle(this.more).display !== "none";
    if (isNarrow === (this.bar.firstChild === this.extra)) return;
    if (isNarrow) this.bar.prepend(this.extra);
    else this.more.after(this.extra);
  }

  /** @param {boolean} isShown */
  #showExtra(isShown) {
    this.bar.classList.toggle("open", isShown);
    this.more.setAttribute("aria-expanded", String(isShown));
  }

  /**
   * Lists cameras in the order of their names. In the manifest, held-out cameras come last.
   * @param {string[]} cameras
   */
  setCameras(cameras) {
    const options = cameras.map((name, index) => new Option(name, String(index)));
    options.sort((one, other) => one.text.localeCompare(other.text, "en", { numeric: true }));
    this.camera.replaceChildren(new Option("Camera", ""), ...options);
    this.camera.hidden = cameras.length === 0;
  }

  /**
   * Shows the state of playback.
   * @param {import("../play/clock.js").Clock} clock
   */
  showTime(clock) {
    const last = clock.frames - 1;
    setIcon(this.play, clock.isPlaying ? "pause" : "play");
    setText(this.time, `${(clock.frame / clock.fps).toFixed(2)} / ${(clock.frames / clock.fps).toFixed(2)} s`);
    if (this.scrub.max !== String(last)) this.scrub.max = String(last);
    if (this.scrub.value !== String(clock.frame)) this.scrub.value = String(clock.frame);
    if (this.speed.value !== String(clock.speed)) this.speed.value = String(clock.speed);
    this.loop.setAttribute("aria-pressed", String(clock.loops));
  }
}

/**
 * @param {string} className
 * @param {string[][]} rows
 */
function makeTable(className, rows) {
  const table = element("table", { className });
  for (const [input, action] of rows) {
    const row = table.insertRow();
    row.insertCell().textContent = input;
    row.insertCell().textContent = action;
  }
  return table;
}

function makeHelp() {
  const help = element("div", { className: "help", hidden: true });
  help.append(makeTable("with-keys", HELP), makeTable("with-fingers", TOUCH_HELP));
  return help;
}

/**
 * @param {import("./icons.js").IconName} icon
 * @param {string} title
 */
function button(icon, title) {
  const made = element("button", { type: "button", title });
  setIcon(made, icon);
  made.setAttribute("aria-label", title);
  return made;
}

/** @param {string} title */
function list(title) {
  const made = element("select", { title });
  // Not all screen readers say titles.
  made.setAttribute("aria-label", title);
  return made;
}

/**
 * @template {keyof HTMLElementTagNameMap} Name
 * @param {Name} name
 * @param {Partial<HTMLElementTagNameMap[Name]>} properties
 * @returns {HTMLElementTagNameMap[Name]}
 */
function element(name, properties) {
  return Object.assign(document.createElement(name), properties);
}

/**
 * @param {HTMLElement} target
 * @param {string} text
 */
function setText(target, text) {
  if (target.textContent !== text) target.textContent = text;
}
