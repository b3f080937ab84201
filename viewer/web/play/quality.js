const SLOW_MS = 45;
const FAST_MS = 20;
const LOWEST = 0.4;
const STEP = 0.8;
const IMAGES = 6;

/** Adapts the resolution to the drawing times of the images while the view moves or the scene plays. */
export class Quality {
  constructor() {
    /** Width and height of the image, as a fraction of the full width and height. */
    this.scale = 1;
    this.mean = 0;
    this.count = 0;
  }

  /**
   * Reports the time from drawing an image until the browser could show the next one.
   * @param {number} ms
   */
  report(ms) {
    if (ms > 1000) return; // Ignore times above one second, in which the page was probably hidden.
    this.count++;
    this.mean += (ms - this.mean) / Math.min(this.count, IMAGES);
    if (this.count < IMAGES) return;
    if (this.mean > SLOW_MS && this.scale > LOWEST) this.#change(Math.max(this.scale * STEP, LOWEST));
    else if (this.mean < FAST_MS && this.scale < 1) this.#change(Math.min(this.scale / STEP, 1));
  }

  /** Starts a new measurement. Must be called in each time step in which nothing moves. */
  rest() {
    this.count = 0;
    this.mean = 0;
  }

  /** @param {number} scale */
  #change(scale) {
    this.scale = scale;
    this.rest();
  }
}
