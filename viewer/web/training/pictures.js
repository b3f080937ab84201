import { setText, within } from "./elements.js";

/** Shows a validation image of a run, which is the newest one until the user selects another. */
export class Pictures {
  /** @param {HTMLElement} parent */
  constructor(parent) {
    this.parent = parent;
    this.image = within(parent, "img");
    this.input = within(parent, "input");
    this.caption = within(parent, "span");
    /** @type {number[]} */
    this.steps = [];
    /** @type {number | null} */
    this.segment = null;
    this.input.addEventListener("input", () => this.#draw());
  }

  /**
   * @param {number[]} steps
   * @param {number | null} segment
   */
  show(steps, segment) {
    const isSame = segment === this.segment && steps.join() === this.steps.join();
    if (isSame) return;
    const selected = this.steps[this.input.valueAsNumber];
    const isNewest = this.input.valueAsNumber >= this.steps.length - 1;
    this.steps = steps;
    this.segment = segment;
    this.parent.hidden = steps.length === 0;
    this.input.max = String(Math.max(steps.length - 1, 0));
    const kept = isNewest ? -1 : steps.indexOf(selected);
    this.input.value = String(kept < 0 ? steps.length - 1 : kept);
    this.#draw();
  }

  #draw() {
    const step = this.steps[this.input.valueAsNumber];
    if (step === undefined) return;
    const part = this.segment === null ? "" : `?segment=${this.segment}`;
    this.image.src = `run/pictures/${step}.jpg${part}`;
    setText(this.caption, `Step ${step.toLocaleString("en")}: captured on the left, rendered on the right`);
  }
}
