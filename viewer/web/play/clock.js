/** The time of playback. The time does not advance until the frame that is due has arrived. */
export class Clock {
  /**
   * @param {number} frames
   * @param {number} fps
   */
  constructor(frames, fps) {
    this.frames = frames;
    this.fps = fps;
    this.seconds = 0;
    this.speed = 1;
    this.isPlaying = false;
    this.loops = true;
  }

  get duration() {
    return this.frames / this.fps;
  }

  /** Index of the frame that is due. */
  get frame() {
    return Math.min(Math.floor(this.seconds * this.fps + 1e-6), this.frames - 1);
  }

  /** @param {number} frame */
  seek(frame) {
    this.seconds = Math.min(Math.max(frame, 0), this.frames - 1) / this.fps;
  }

  /**
   * Advances the time.
   * @param {number} elapsed In seconds.
   */
  advance(elapsed) {
    if (!this.isPlaying) return;
    const next = this.seconds + elapsed * this.speed;
    if (next < this.duration) {
      this.seconds = next;
    } else if (this.loops) {
      this.seconds = next % this.duration;
    } else {
      this.seek(this.frames - 1);
      this.isPlaying = false;
    }
  }

  /** Starts or pauses. At the end, playback starts again at the first frame. */
  toggle() {
    this.isPlaying = !this.isPlaying;
    if (this.isPlaying && !this.loops && this.frame === this.frames - 1) this.seconds = 0;
  }

  /**
   * The frames that are due after the current frame.
   * @param {number} count
   * @returns {number[]}
   */
  upcoming(count) {
    const found = [];
    for (let step = 1; step <= Math.min(count, this.frames - 1); step++) {
      const frame = this.frame + step;
      if (frame < this.frames) found.push(frame);
      else if (this.loops) found.push(frame - this.frames);
    }
    return found;
  }
}
