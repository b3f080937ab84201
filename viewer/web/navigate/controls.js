import { dolly, fly, orbit, pan } from "./pose.js";
/** @typedef {import("./pose.js").Pose} Pose */

const WHEEL_FACTOR = 0.9;
const WHEEL_NOTCH = 100;
/** Time in seconds to fly from the eye to the pivot. */
const SECONDS_TO_PIVOT = 2;
const SHIFT_FACTOR = 4;
const FLY_KEYS = new Set(["KeyW", "KeyA", "KeyS", "KeyD", "KeyQ", "KeyE"]);

/** Moves a pose by mouse, touch and keys, as viewer/controls.py does. */
export class Controls {
  /**
   * @param {HTMLElement} surface Element that receives drags and the wheel.
   * @param {HTMLElement} host Element that has the keyboard focus.
   * @param {() => Pose | null} getPose
   * @param {(pose: Pose) => void} setPose
   */
  constructor(surface, host, getPose, setPose) {
    this.surface = surface;
    this.host = host;
    this.getPose = getPose;
    this.setPose = setPose;
    /** @type {Map<number, {x: number, y: number}>} */
    this.pointers = new Map();
    /** @type {Set<string>} */
    this.keys = new Set();
    this.shift = false;
    surface.addEventListener("pointerdown", (event) => this.#press(event));
    surface.addEventListener("pointermove", (event) => this.#move(event));
    for (const name of /** @type {const} */ (["pointerup", "pointercancel"])) {
      surface.addEventListener(name, (event) => this.pointers.delete(event.pointerId));
    }
    surface.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    surface.addEventListener("contextmenu", (event) => event.preventDefault());
    host.addEventListener("keydown", (event) => this.#key(event, true));
    host.addEventListener("keyup", (event) => this.#key(event, false));
    host.addEventListener("focusout", () => this.keys.clear());
  }

  /** Whether the user is moving the view. */
  get isActive() {
    return this.pointers.size > 0 || this.keys.size > 0;
  }

  /**
   * Applies the keys that are held down.
   * @param {number} seconds Time since the last call.
   */
  update(seconds) {
    const pose = this.getPose();
    if (!pose || this.keys.size === 0) return;
    const step = (pose.distance / SECONDS_TO_PIVOT) * seconds * (this.shift ? SHIFT_FACTOR : 1);
    /** @type {(positive: string, negative: string) => number} */
    const axis = (positive, negative) => step * (Number(this.keys.has(positive)) - Number(this.keys.has(negative)));
    this.setPose(fly(pose, axis("KeyD", "KeyA"), axis("KeyE", "KeyQ"), axis("KeyW", "KeyS")));
  }

  /** @param {PointerEvent} event */
  #press(event) {
    this.surface.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  }

  /** @param {PointerEvent} event */
  #move(event) {
    const last = this.pointers.get(event.pointerId);
    const pose = this.getPose();
    if (!last || !pose) return;
    const height = Math.max(this.surface.clientHeight, 1);
    const right = (event.clientX - last.x) / height;
    const down = (event.clientY - last.y) / height;
    const before = this.#spread();
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (event.pointerType === "touch") this.setPose(this.#touch(pose, right, down, before));
    else this.setPose(drag(pose, right, down, event));
  }

  /**
   * One finger orbits. Two fingers pan, and a change of the distance between them dollies.
   * @param {Pose} pose
   * @param {number} right
   * @param {number} down
   * @param {number} before Distance between the two fingers before the motion.
   */
  #touch(pose, right, down, before) {
    if (this.pointers.size === 1) return orbit(pose, 2 * Math.PI * right, 2 * Math.PI * down);
    const panned = pan(pose, right / this.pointers.size, down / this.pointers.size);
    const after = this.#spread();
    return before > 0 && after > 0 ? dolly(panned, before / after) : panned;
  }

  /** Returns the distance between the first two fingers in pixels, or 0 if there are fewer fingers. */
  #spread() {
    const [first, second] = [...this.pointers.values()];
    return second ? Math.hypot(first.x - second.x, first.y - second.y) : 0;
  }

  /**
   * Dollies. On a page that scrolls, the wheel scrolls until the user has clicked on the scene.
   * @param {WheelEvent} event
   */
  #wheel(event) {
    if (this.host.hasAttribute("embedded") && !this.host.matches(":focus-within")) return;
    event.preventDefault();
    const pose = this.getPose();
    const pixels = event.deltaMode === WheelEvent.DOM_DELTA_PIXEL ? event.deltaY : 33 * event.deltaY;
    if (pose) this.setPose(dolly(pose, WHEEL_FACTOR ** (-pixels / WHEEL_NOTCH)));
  }

  /**
   * @param {KeyboardEvent} event
   * @param {boolean} isDown
   */
  #key(event, isDown) {
    this.shift = event.shiftKey;
    if (!FLY_KEYS.has(event.code) || (isDown && (event.ctrlKey || event.altKey || event.metaKey))) return;
    if (isDown) this.keys.add(event.code);
    else this.keys.delete(event.code);
  }
}

/**
 * @param {Pose} pose
 * @param {number} right
 * @param {number} down
 * @param {PointerEvent} event
 */
function drag(pose, right, down, event) {
  const isRight = (event.buttons & 2) !== 0;
  if (isRight || event.shiftKey) return pan(pose, right, down);
  if (event.ctrlKey) return dolly(pose, Math.exp(2 * down));
  return orbit(pose, 2 * Math.PI * right, 2 * Math.PI * down);
}
