/** A mapping from values to positions on an axis. Ticks are the labelled values.
 * @typedef {{position: (value: number) => number, ticks: number[]}} Axis */

/**
 * Makes an axis from 0 to `length` pixels.
 * @param {number} least
 * @param {number} largest
 * @param {number} length
 * @param {boolean} isLog Requires positive values.
 * @param {number} count Approximate number of ticks.
 * @returns {Axis}
 */
export function makeAxis(least, largest, length, isLog, count) {
  if (isLog) return makeLogAxis(least, largest, length, count);
  const span = largest - least || Math.abs(largest) || 1;
  const low = largest > least ? least : least - span / 2;
  const step = niceStep(span / count);
  const ticks = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= low + span * (1 + 1e-9) && ticks.length < 50; k++) ticks.push(k * step);
  return { position: (value) => ((value - low) / span) * length, ticks };
}

/**
 * @param {number} least
 * @param {number} largest
 * @param {number} length
 * @param {number} count
 * @returns {Axis}
 */
function makeLogAxis(least, largest, length, count) {
  const low = Math.log10(least);
  const span = Math.log10(largest) - low || 1;
  const factors = span < 2.5 ? [1, 2, 5] : [1];
  const stride = Math.max(1, Math.ceil(span / count));
  const ticks = [];
  for (let power = Math.floor(low); power <= low + span && ticks.length < 50; power++) {
    if (power % stride !== 0) continue;
    for (const factor of factors) {
      const tick = factor * 10 ** power;
      if (tick >= least * 0.999 && Math.log10(tick) <= low + span + 1e-9) ticks.push(tick);
    }
  }
  return { position: (value) => ((Math.log10(value) - low) / span) * length, ticks };
}

/**
 * Returns the smallest number of the form 1, 2 or 5 times a power of ten that is at least `step`.
 * @param {number} step
 */
function niceStep(step) {
  const power = 10 ** Math.floor(Math.log10(step));
  const factor = [1, 2, 5, 10].find((each) => each * power >= step * 0.999) ?? 10;
  return factor * power;
}

/**
 * Formats a number with up to four significant digits. Large numbers get a suffix such as k.
 * @param {number} value
 */
export function formatNumber(value) {
  const size = Math.abs(value);
  if (size >= 1e6) return `${Number((value / 1e6).toPrecision(4))} M`;
  if (size >= 1e5) return `${Number((value / 1e3).toPrecision(4))} k`;
  if (size !== 0 && size < 1e-3) return value.toExponential(1);
  return String(Number(value.toPrecision(4)));
}

/**
 * Formats a duration as h:mm:ss.
 * @param {number} seconds
 */
export function formatDuration(seconds) {
  const whole = Math.max(0, Math.round(seconds));
  const two = (/** @type {number} */ value) => String(value).padStart(2, "0");
  return `${Math.floor(whole / 3600)}:${two(Math.floor(whole / 60) % 60)}:${two(whole % 60)}`;
}
