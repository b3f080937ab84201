/** The strides of playback over slow connections. With a stride s, playback shows every s-th frame, so a larger stride
 * needs a lower data rate. */
const STRIDES = [1, 2, 3, 4, 5, 6];
/** Maximum time in seconds for which the start of playback is delayed in order to show more frames. */
export const LONGEST_WAIT = 3;
/** Fraction of the measured data rate with which playback is planned, because the rate varies. */
const RATE_MARGIN = 0.9;
/** Fraction of the measured data rate with which a change to a smaller stride is planned. */
const FINER_MARGIN = 0.8;
/** Playback changes to a larger stride if it would otherwise pause within this time, in seconds. */
const FORESIGHT = 2;
/** Pauses shorter than this time, in seconds, do not change the stride. They occur when the view moves and needs a
 * source view that is not loaded yet. */
const SHORT_PAUSE = 0.25;

/**
 * The frames that are due next, and how much of their data is still to be downloaded.
 * @typedef {object} Buffer
 * @property {number[]} frames Successive frames in playback order.
 * @property {number[]} missing For each frame, the number of bytes that have not been downloaded.
 * @property {number} interval Seconds between two frames.
 * @property {number} rate Data rate of the connection in bytes per second.
 */

/**
 * Returns the time in seconds to wait before playback starts, so that each frame arrives before it is due.
 * @param {Buffer} buffer
 * @param {number} stride Only frames whose numbers are multiples of the stride are shown.
 */
export function requiredWait({ frames, missing, interval, rate }, stride) {
  let bytes = 0;
  let wait = 0;
  for (let step = 0; step < frames.length; step++) {
    if (frames[step] % stride !== 0 || missing[step] === 0) continue;
    bytes += missing[step];
    wait = Math.max(wait, bytes / rate - step * interval);
  }
  return wait;
}

/**
 * Returns the smallest stride with which playback can start within `patience` seconds, or else the stride that allows
 * the earliest start, and the time until playback can start.
 * @param {Buffer} buffer
 * @param {number} patience In seconds.
 * @returns {{stride: number, wait: number}}
 */
export function planStart(buffer, patience) {
  const slower = { ...buffer, rate: RATE_MARGIN * buffer.rate };
  const plans = STRIDES.map((stride) => ({ stride, wait: requiredWait(slower, stride) }));
  return plans.find(({ wait }) => wait <= patience) ?? plans.reduce((best, plan) => (plan.wait < best.wait ? plan : best));
}

/**
 * Returns the stride for the next frames during playback.
 * @param {Buffer} buffer
 * @param {number} stride The current stride.
 */
export function adaptStride(buffer, stride) {
  const soon = Math.ceil(FORESIGHT / buffer.interval);
  const next = { ...buffer, frames: buffer.frames.slice(0, soon), rate: RATE_MARGIN * buffer.rate };
  if (requiredWait(next, stride) > SHORT_PAUSE) return Math.max(planStart(buffer, SHORT_PAUSE).stride, stride);
  const finer = { ...buffer, rate: FINER_MARGIN * buffer.rate };
  return STRIDES.find((value) => value >= stride || requiredWait(finer, value) === 0) ?? stride;
}
