/** The playback clock, which selects the frame to show. */
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
    /** During playback, only frames whose numbers are multiples of the stride are due. */
    this.stride = 1;
  }

  get duration() {
    return this.frames / this.fps;
  }

  /** Index of the frame that is due. */
  get frame() {
    const { exactFrame } = this;
    return this.isPlaying ? exactFrame - (exactFrame % this.stride) : exactFrame;
  }

  /** Index of the frame at the current time with a stride of 1. */
  get exactFrame() {
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

  /** Starts or pauses playback. If it does not loop and has reached the end, it restarts at the first frame. */
  toggle() {
    this.isPlaying = !this.isPlaying;
    if (this.isPlaying && !this.loops && this.exactFrame === this.frames - 1) this.seconds = 0;
  }

  /**
   * Returns the frames that are due after the current frame.
   * @param {number} count
   * @param {number} [stride]
   * @returns {number[]}
   */
  upcoming(count, stride = this.isPlaying ? this.stride : 1) {
    const found = [];
    let next = this.frame;
    for (let step = 1; step <= Math.min(count, Math.ceil(this.frames / stride) - 1); step++) {
      next += stride;
      if (next >= this.frames) {
        if (!this.loops) break;
        next = 0;
      }
      found.push(next);
    }
    return found;
  }
}
