import { SceneError, describeError } from "../scene/errors.js";
import { SOUND } from "../scene/members.js";
import { opusSeconds } from "../scene/ogg.js";

/** Longest sound, in seconds, that the player decodes. Decoded sound needs 23 MB a minute. */
const MAX_SECONDS = 1200;
/** Difference in seconds between the declared and the actual duration that is accepted. */
const TOLERANCE = 0.2;
/** Time in seconds from the decision to start the sound to its first sample, so that it starts at an exact time. */
const LEAD = 0.02;
/** Duration in seconds of a fade at the start and at the end, which avoids clicks. */
const FADE = 0.004;
/** If the sound is this time ahead of or behind the picture, in seconds, it starts again at the right position. */
const RESTART = 0.03;
/** A larger error, in seconds, is not noise of the clocks but a jump of the picture. */
const JUMP = 0.1;
/** From this error in seconds on, the sound plays a little faster or slower, which nobody hears. */
const NUDGE = 0.006;
const NUDGE_RATE = 0.003;
/** Weight of the newest error in the mean. The times of browsers are multiples of a few milliseconds. */
const NEWEST = 0.1;
const NEWEST_DELAY = 0.03;
/** Longest delay in seconds, from the time at which a frame is due to its drawing, that the sound makes up for. */
const MAX_DELAY = 0.15;
/** The sound stops after this time in seconds if nobody follows the picture, as in a hidden tab. */
const ALONE = 1;

/**
 * The sound of a scene. It follows the picture: it starts, stops and jumps with the playback clock, and its drift is
 * corrected. It is off until `setOn(true)` is called, which browsers allow only while they handle a click or a key.
 */
export class Sound {
  /**
   * @param {import("../scene/scene_file.js").SceneFile} file
   * @param {import("../scene/manifest.js").SoundEntry} entry
   * @param {import("./clock.js").Clock} clock
   */
  constructor(file, entry, clock) {
    this.file = file;
    this.entry = entry;
    this.clock = clock;
    this.isOn = false;
    /** What went wrong, in one line, or an empty string. The scene plays on without sound. */
    this.problem = "";
    /** @type {AudioContext | null} */
    this.context = null;
    /** @type {AudioBuffer | null} */
    this.buffer = null;
    /** @type {AudioBufferSourceNode | null} */
    this.source = null;
    /** @type {GainNode | null} */
    this.gain = null;
    /** Position in the scene of the sample that is rendered at the time `time` of the context. */
    this.anchor = { time: 0, position: 0, rate: 1 };
    this.speed = 1;
    /** Mean error in seconds: how far the sound is ahead of the picture. */
    this.error = 0;
    this.starts = 0;
    this.shownFrame = -1;
    /** Mean time in seconds from the time at which a frame is due to its drawing, or null before the first frame.
     * @type {number | null} */
    this.delay = null;
    this.abort = new AbortController();
  }

  /**
   * Switches the sound on or off. The first call loads it.
   * @param {boolean} isOn
   */
  setOn(isOn) {
    this.isOn = isOn && !this.problem;
    if (!this.isOn) return this.rest();
    if (!this.context) this.#load();
    this.resume();
  }

  /** Tells the browser, while it handles a click or a key, that the sound may play. */
  resume() {
    if (this.isOn && this.context?.state !== "running") this.context?.resume().catch(() => {});
  }

  /** Whether sound is heard now. */
  get isPlaying() {
    return this.source !== null;
  }

  /** The time in the scene, in seconds, of the sound that leaves the loudspeaker now. */
  get heard() {
    const { context, anchor } = this;
    if (!context) return 0;
    return anchor.position + (context.currentTime - latency(context) - anchor.time) * anchor.rate;
  }

  /**
   * Adjusts the sound to the playback clock. Called once per displayed image.
   * @param {boolean} isRunning Whether the clock advances.
   */
  follow(isRunning) {
    const { context, buffer, clock, source } = this;
    if (!isRunning || !this.isOn || !context || !buffer || context.state !== "running") return this.rest();
    if (!source || this.speed !== clock.speed) return this.#start(context, buffer);
    source.loop = clock.loops;
    source.stop(context.currentTime + ALONE);
    const error = this.#errorNow();
    this.error += NEWEST * (error - this.error);
    if (Math.abs(error) > JUMP || Math.abs(this.error) > RESTART) return this.#start(context, buffer);
    const nudge = Math.abs(this.error) > NUDGE ? -Math.sign(this.error) * NUDGE_RATE : 0;
    this.#setRate(context, source, clock.speed * (1 + nudge));
  }

  /**
   * Learns how late frames are drawn, because their points are sorted first. Called whenever an image is drawn.
   * @param {number} frame
   */
  shown(frame) {
    const { clock } = this;
    if (frame === this.shownFrame || !clock.isPlaying) return;
    this.shownFrame = frame;
    const late = (clock.seconds - frame / clock.fps + clock.duration) % clock.duration;
    if (late <= MAX_DELAY) this.delay = this.delay === null ? late : this.delay + NEWEST_DELAY * (late - this.delay);
  }

  /** The time in the scene that the picture shows, in seconds. It can be negative after the start of a loop. */
  get seen() {
    return this.clock.seconds - (this.delay ?? 0);
  }

  /** Stops the sound until the picture moves again. */
  rest() {
    const { context, source, gain } = this;
    if (!context || !source || !gain) return;
    const now = context.currentTime;
    gain.gain.cancelScheduledValues(now);
    gain.gain.setTargetAtTime(0, now, FADE / 3);
    source.onended = null;
    source.stop(now + 2 * FADE);
    this.source = this.gain = null;
  }

  release() {
    this.isOn = false;
    this.abort.abort();
    this.rest();
    this.context?.close().catch(() => {});
    this.context = this.buffer = null;
  }

  /** How far the sound is ahead of the picture, in seconds. In a loop, the end of the scene is next to its start. */
  #errorNow() {
    const { clock } = this;
    const error = this.heard - this.seen;
    return clock.loops ? error - clock.duration * Math.round(error / clock.duration) : error;
  }

  /**
   * Starts the sound at the time of the picture.
   * @param {AudioContext} context
   * @param {AudioBuffer} buffer
   */
  #start(context, buffer) {
    this.rest();
    const { clock } = this;
    const time = context.currentTime + LEAD;
    let position = this.seen + (LEAD + latency(context)) * clock.speed;
    if (position >= clock.duration && !clock.loops) return;
    position = clock.loops ? (position + clock.duration) % clock.duration : Math.max(position, 0);
    const gain = context.createGain();
    gain.gain.setValueAtTime(0, time);
    gain.gain.linearRampToValueAtTime(1, time + FADE);
    gain.connect(context.destination);
    const source = context.createBufferSource();
    source.buffer = buffer;
    source.loop = clock.loops;
    source.loopEnd = clock.duration;
    source.playbackRate.value = clock.speed;
    source.connect(gain);
    source.onended = () => {
      if (this.source === source) this.source = this.gain = null;
    };
    source.start(time, position);
    Object.assign(this, { source, gain, speed: clock.speed, error: 0, anchor: { time, position, rate: clock.speed } });
    this.starts++;
  }

  /**
   * @param {AudioContext} context
   * @param {AudioBufferSourceNode} source
   * @param {number} rate
   */
  #setRate(context, source, rate) {
    const { anchor } = this;
    if (rate === anchor.rate) return;
    const time = context.currentTime;
    this.anchor = { time, position: anchor.position + (time - anchor.time) * anchor.rate, rate };
    source.playbackRate.setValueAtTime(rate, time);
  }

  async #load() {
    try {
      if (this.entry.duration > MAX_SECONDS) throw new SceneError(`it is longer than ${MAX_SECONDS / 60} minutes`);
      this.context = new AudioContext();
      const bytes = (await this.file.read([SOUND], this.abort.signal)).get(SOUND) ?? new Uint8Array(0);
      const seconds = opusSeconds(bytes);
      if (seconds > this.entry.duration + TOLERANCE) {
        throw new SceneError(`sound.ogg: expected ${this.entry.duration} s, got ${seconds} s; export the scene again`);
      }
      const decoded = await this.context.decodeAudioData(/** @type {ArrayBuffer} */ (bytes.slice().buffer));
      this.buffer = spread(this.context, decoded, this.entry.start, this.clock.duration);
    } catch (error) {
      if (this.abort.signal.aborted) return;
      const isKnown = error instanceof SceneError;
      this.problem = `The scene has no sound here: ${isKnown ? describeError(error) : "the browser does not decode Opus"}`;
      this.setOn(false);
    }
  }
}

/**
 * Returns the sound with silence before and after it, so that it is as long as the scene and can loop with it.
 * @param {AudioContext} context
 * @param {AudioBuffer} sound
 * @param {number} start In seconds.
 * @param {number} duration Of the scene, in seconds.
 */
function spread(context, sound, start, duration) {
  const rate = sound.sampleRate;
  const whole = context.createBuffer(sound.numberOfChannels, Math.max(Math.ceil(duration * rate), 1), rate);
  const first = Math.round(start * rate);
  for (let channel = 0; channel < sound.numberOfChannels && first < whole.length; channel++) {
    whole.copyToChannel(sound.getChannelData(channel).subarray(0, whole.length - first), channel, first);
  }
  return whole;
}

/**
 * Returns the time in seconds from a sample that is rendered to its sound.
 * @param {AudioContext} context
 */
function latency(context) {
  return context.outputLatency || context.baseLatency || 0;
}
