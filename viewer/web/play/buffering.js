/** Plans playback over slow connections. With a stride s, playback shows every s-th frame, so a larger stride needs a
 * lower data rate. */
const STRIDES = [1, 2, 3, 4, 5, 6];
/** Maximum time in seconds that playback waits in order to show all frames. */
export const LONGEST_WAIT = 3;
/** The data rate varies, so playback is planned with this fraction of the measured rate. */
const RATE_MARGIN = 0.9;
/** A change to a smaller stride is planned with this fraction of the measured data rate. */
const FINER_MARGIN = 0.8;
/** Playback changes to a larger stride if it would otherwise pause within this time, in seconds. */
const FORESIGHT = 2;
/** Pauses shorter than this time, in seconds, do not change the stride. Short pauses occur when the view moves and
 * needs a source view that is not loaded. */
const SHORT_PAUSE = 0.25;

/**
 * The frames that are due next, and the amount of their data that has not been downloaded.
 * @typedef {object} Buffer
 * @property {number[]} frames Successive frames in the order of playback.
 * @property {number[]} missing For each frame, the number of bytes that have not been downloaded.
 * @property {number} interval Seconds between two frames.
 * @property {number} rate Rate of the connection in bytes per second.
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
 * Returns the smallest stride with which playback can start within `patience` seconds, and the remaining waiting time.
 * If there is no such stride, returns the stride with the shortest waiting time.
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
