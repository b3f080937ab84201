/**
 * Returns the natural cubic spline through points.
 * @param {number[]} s Increasing parameters of the points, at least 2.
 * @param {number[][]} points
 * @returns {(at: number) => number[]}
 */
export function naturalSpline(s, points) {
  const count = s.length;
  const size = points[0].length;
  // Second derivatives, from the tridiagonal system that makes the first derivatives continuous (Thomas algorithm).
  const curvature = points.map(() => new Array(size).fill(0));
  const factors = new Array(count).fill(0);
  for (let i = 1; i < count - 1; i++) {
    const [before, after] = [s[i] - s[i - 1], s[i + 1] - s[i]];
    const pivot = 2 * (before + after) - before * factors[i - 1];
    factors[i] = after / pivot;
    for (let k = 0; k < size; k++) {
      const slopes = (points[i + 1][k] - points[i][k]) / after - (points[i][k] - points[i - 1][k]) / before;
      curvature[i][k] = (6 * slopes - before * curvature[i - 1][k]) / pivot;
    }
  }
  for (let i = count - 2; i > 0; i--) {
    for (let k = 0; k < size; k++) curvature[i][k] -= factors[i] * curvature[i + 1][k];
  }
  return (at) => {
    const i = intervalOf(s, at);
    const h = s[i + 1] - s[i];
    const b = Math.min(Math.max((at - s[i]) / h, 0), 1);
    const a = 1 - b;
    return points[i].map((value, k) => {
      const bend = ((a ** 3 - a) * curvature[i][k] + (b ** 3 - b) * curvature[i + 1][k]) * h * h;
      return a * value + b * points[i + 1][k] + bend / 6;
    });
  };
}

/**
 * Returns a cubic spline that is monotone between two points (PCHIP, Fritsch and Butland 1984).
 * @param {number[]} x Increasing.
 * @param {number[]} y
 * @returns {(at: number) => number}
 */
export function monotoneCubic(x, y) {
  if (x.length === 1) return () => y[0];
  const steps = x.slice(1).map((value, i) => value - x[i]);
  const slopes = steps.map((step, i) => (y[i + 1] - y[i]) / step);
  const last = slopes.length - 1;
  const derivatives = x.map((_, i) => {
    if (last === 0) return slopes[0];
    if (i === 0) return endDerivative(steps[0], steps[1], slopes[0], slopes[1]);
    if (i > last) return endDerivative(steps[last], steps[last - 1], slopes[last], slopes[last - 1]);
    if (slopes[i - 1] * slopes[i] <= 0) return 0;
    const before = 2 * steps[i] + steps[i - 1];
    const after = steps[i] + 2 * steps[i - 1];
    return (before + after) / (before / slopes[i - 1] + after / slopes[i]);
  });
  return (at) => {
    const i = intervalOf(x, at);
    const t = Math.min(Math.max((at - x[i]) / steps[i], 0), 1);
    const bent = steps[i] * t * (1 - t) * ((1 - t) * derivatives[i] - t * derivatives[i + 1]);
    return y[i] + (y[i + 1] - y[i]) * t * t * (3 - 2 * t) + bent;
  };
}

/**
 * Returns the derivative at an end, from the two intervals next to it.
 * @param {number} step
 * @param {number} nextStep
 * @param {number} slope
 * @param {number} nextSlope
 */
function endDerivative(step, nextStep, slope, nextSlope) {
  const found = ((2 * step + nextStep) * slope - step * nextSlope) / (step + nextStep);
  if (Math.sign(found) !== Math.sign(slope)) return 0;
  return Math.sign(slope) !== Math.sign(nextSlope) && Math.abs(found) > 3 * Math.abs(slope) ? 3 * slope : found;
}

/**
 * Returns the index of the interval of an increasing list that contains a value, or that is nearest to it.
 * @param {number[]} list
 * @param {number} value
 */
function intervalOf(list, value) {
  let index = 0;
  while (index < list.length - 2 && list[index + 1] <= value) index++;
  return index;
}
