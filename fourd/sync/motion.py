"""Time offsets between cameras without a common trigger, from the motion energy of their pictures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from fourd.files import write_bytes_atomically

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

NOISE_SIGMAS = 3.0
ENERGY_FLOOR = 0.1
"""Share of the median energy added before the logarithm, which limits the steps at still frames."""
FINE_SIGMA_FRAMES, COARSE_SIGMA_FRAMES = 1.0, 6.0
"""Standard deviations of the difference of Gaussians that is correlated: a band-pass over few frames."""
MAX_SIGNAL = 4.0
"""Clipping level in robust standard deviations: cuts and flashes are in one camera alone."""
PEAK_RADIUS_FRAMES = 3
MIN_OVERLAP = 12
MAX_LAG_ERROR_FRAMES = 1.0
NOISE_CORRELATION = 4.0
"""Divided by the square root of the number of frames: the correlation that noise reaches over some tens of lags."""

MARGIN, LABEL, PANEL, ROW = 16, 290, 480, 56
INK, GRID, WARNING = (40, 40, 40), (215, 215, 215), (60, 60, 200)


@dataclass(frozen=True, eq=False)
class Offsets:
    """Delay of each camera relative to the first.

    With offset o, frame f of the capture is frame f + o of the camera's video: an event at frame f of the first
    camera is at frame f + o of this one. A camera that started to record 7 frames late lacks its first 7 and has
    o = -7.

    Attributes:
        frames: whole frames; 0 for the first camera.
        subframes: the same with fractions, from parabolas through the correlations' peaks.
        confidence: in [0, 1]. With p1 the peak of a pair's correlation, p2 the highest value more than 3 frames away
            from it and c = 4 / sqrt(frames) the level that noise reaches, a pair's confidence is the smaller of
            (p1 - c) / (1 - c) and 2 (p1 - p2), and 0 where its lag differs from the solution by more than a frame. A
            camera's confidence is the mean of the better half of its pairs. Above 0.3 is good; below 0.1 the offset
            is unreliable.
    """

    frames: tuple[int, ...]
    subframes: tuple[float, ...]
    confidence: tuple[float, ...]


def motion_energy(pictures: Iterable[Grey]) -> Array:
    """(F,) mean difference of each picture from the one before, in grey levels; the first has the second's value.

    The pictures (H, W) are uint8 and read one at a time; a width of 200 pixels is enough. Changes of the whole
    picture, such as exposure flicker, are fitted by a gain and an offset and removed. Differences within 3 standard
    deviations of the noise, estimated from the median difference, count as 0.

    Raises:
        ValueError: when pictures differ in size.
    """
    energies: list[float] = []
    before: NDArray[np.float32] | None = None
    for picture in pictures:
        now = np.asarray(cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 0.8), np.float32)
        if before is not None and before.shape != now.shape:
            raise ValueError(f"pictures: expected {before.shape} pixels, as the one before, got {now.shape}")
        energies.append(0.0 if before is None else _difference(before, now))
        before = now
    if len(energies) > 1:
        energies[0] = energies[1]
    return np.array(energies, np.float64)


def _difference(before: NDArray[np.float32], now: NDArray[np.float32]) -> float:
    gain, offset = _fit_exposure(before.ravel()[::3], now.ravel()[::3])
    difference = np.abs(now - gain * before - offset)
    noise = 1.4826 * float(np.median(difference))
    return float(np.maximum(difference - NOISE_SIGMAS * noise, 0).mean())


def _fit_exposure(before: NDArray[np.float32], now: NDArray[np.float32]) -> tuple[float, float]:
    """Gain and offset from ``before`` to ``now``: a line, refitted without the pixels that moved."""
    gain, offset = 1.0, float(np.median(now - before))
    for _ in range(3):
        error = np.abs(now - gain * before - offset)
        still = error <= max(2 * float(np.median(error)), 1.0)
        x, y = before[still], now[still]
        centred = x - x.mean()
        power = float(centred @ centred)
        if power < len(x):
            # A uniform picture does not determine the gain.
            return 1.0, float(np.median(now - before))
        gain = float(centred @ y) / power
        offset = float(y.mean() - gain * x.mean())
    return gain, offset


def estimate_offsets(energies: Sequence[Array], max_offset: int) -> Offsets:
    """Estimate each camera's delay relative to the first in frames, from its :func:`motion_energy`.

    The logarithms of the energies, band-passed by a difference of Gaussians against gains and slow trends, are
    correlated for every pair of cameras. All lags together give the offsets by weighted least squares, reweighted
    towards least absolute deviations, so that pairs with a flat, ambiguous or inconsistent correlation have little
    weight.

    Cameras see different parts of a motion: for slow and smooth motion even the best lag is off by some frames (up to
    3 at 60 Hz on a balancing man seen from four sides), which the confidence does not show. Sudden motion, such as
    claps or steps, makes the estimate exact. An offset of up to 3 frames is no evidence of a missing trigger.

    Args:
        energies: (F,) of each camera; lengths may differ.
        max_offset: largest offset in frames, at least 1; at least 12 frames must overlap.

    Raises:
        ValueError: when there is no camera, or too few frames for ``max_offset``.
    """
    if not energies or max_offset < 1:
        raise ValueError(f"expected at least 1 camera and 1 frame, got {len(energies)} and {max_offset}")
    shortest = min(len(energy) for energy in energies)
    if shortest - max_offset < MIN_OVERLAP:
        limit = max(shortest - MIN_OVERLAP, 0)
        raise ValueError(f"max_offset: expected at most {limit} frames of {shortest}, got {max_offset}")
    signals = [_bandpass(energy) for energy in energies]
    pairs = list(combinations(range(len(signals)), 2))
    found = [_estimate_lag(signals[i], signals[j], max_offset) for i, j in pairs]
    lags = np.array([lag for lag, _ in found])
    weights = np.array([weight for _, weight in found])
    solution = _solve(pairs, lags, weights, len(signals))
    agrees = np.array(
        [abs(solution[j] - solution[i] - lag) <= MAX_LAG_ERROR_FRAMES for (i, j), lag in zip(pairs, lags, strict=True)]
    )
    agreed = list(zip(weights * agrees, pairs, strict=True))
    confidence = [_confidence([q for q, pair in agreed if camera in pair]) for camera in range(len(signals))]
    return Offsets(tuple(round(float(o)) for o in solution), tuple(map(float, solution)), tuple(confidence))


def _confidence(weights: Sequence[float]) -> float:
    """Mean of the better half; 1 for a single camera."""
    better = sorted(weights, reverse=True)[: (len(weights) + 1) // 2]
    return float(np.mean(better)) if better else 1.0


def _bandpass(energy: Array) -> Array:
    """(F,) band-passed log energy, normalised and clipped; zeros for a constant energy."""
    level = ENERGY_FLOOR * float(np.median(energy)) + 1e-3 * float(np.max(energy, initial=0)) + 1e-9
    logarithm = np.log(energy + level)
    band = gaussian_filter1d(logarithm, FINE_SIGMA_FRAMES) - gaussian_filter1d(logarithm, COARSE_SIGMA_FRAMES)
    scale = 1.4826 * float(np.median(np.abs(band)))
    scale = scale if scale > 1e-9 else float(band.std())
    return np.clip(band / scale, -MAX_SIGNAL, MAX_SIGNAL) if scale > 1e-9 else np.zeros_like(band)


def _estimate_lag(first: Array, second: Array, max_lag: int) -> tuple[float, float]:
    """The subframe lag at which ``second[f + lag]`` correlates best with ``first[f]``, and its weight."""
    scores = np.array([_correlation(first, second, lag) for lag in range(-max_lag, max_lag + 1)])
    top = int(scores.argmax())
    peak = float(scores[top])
    others = np.delete(
        scores, np.arange(max(top - PEAK_RADIUS_FRAMES, 0), min(top + PEAK_RADIUS_FRAMES + 1, len(scores)))
    )
    noise = NOISE_CORRELATION / np.sqrt(min(len(first), len(second)))
    lead = 2 * (peak - max(float(others.max(initial=0)), 0.0))
    weight = float(np.clip(min((peak - noise) / max(1 - noise, 1e-9), lead), 0, 1))
    fraction = 0.0
    if 0 < top < len(scores) - 1:
        left, right = float(scores[top - 1]), float(scores[top + 1])
        curvature = left - 2 * peak + right
        fraction = 0.5 * (left - right) / curvature if curvature < -1e-12 else 0.0
    return top - max_lag + fraction, weight


def _correlation(first: Array, second: Array, lag: int) -> float:
    start, end = max(0, -lag), min(len(first), len(second) - lag)
    x, y = first[start:end], second[start + lag : end + lag]
    x, y = x - x.mean(), y - y.mean()
    norm = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / norm if norm > 1e-9 else 0.0


def _solve(pairs: Sequence[tuple[int, int]], lags: Array, pair_weights: Array, count: int) -> Array:
    """(count,) offsets, the first 0, whose differences fit the lags; 0 where all weights are 0."""
    if not pairs:
        return np.zeros(count)
    design = np.zeros((len(pairs), count))
    for row, (i, j) in enumerate(pairs):
        design[row, i], design[row, j] = -1, 1
    design = design[:, 1:]
    weights = pair_weights**2 + 1e-9
    solution: Array = np.zeros(count - 1)
    for _ in range(30):
        root = np.sqrt(weights)
        solution = np.asarray(np.linalg.lstsq(root[:, None] * design, root * lags, rcond=None)[0], np.float64)
        weights = (pair_weights**2 + 1e-9) / np.maximum(np.abs(design @ solution - lags), 0.2)
    return np.concatenate([[0.0], solution])


def plot_offsets(path: Path | str, names: Sequence[str], energies: Sequence[Array], offsets: Offsets) -> None:
    """Write a PNG of all energies, as recorded (left) and shifted by the offsets (right), atomically.

    Each camera has a row with its name, offset and confidence, red below 0.1. Each row has its own scale. The grey
    lines mark the same frames on both sides.
    """
    height = 3 * MARGIN + ROW * len(names) + MARGIN
    canvas = np.full((height, LABEL + 2 * (PANEL + MARGIN) + MARGIN, 3), 255, np.uint8)
    longest = max(len(energy) for energy in energies)
    panels = (("as recorded", LABEL, [0] * len(names)), ("shifted", LABEL + PANEL + MARGIN, offsets.frames))
    for title, left, shifts in panels:
        _put_text(canvas, f"{title}, frames 0 to {longest - 1}", left, 2 * MARGIN - 8, INK)
        for frame in range(0, longest, _tick_frames(longest)):
            x = left + round(PANEL * frame / max(longest - 1, 1))
            cv2.line(canvas, (x, 2 * MARGIN), (x, height - 2 * MARGIN), GRID, 1)
            _put_text(canvas, str(frame), x - 6, height - MARGIN + 4, INK)
        for row, (energy, shift) in enumerate(zip(energies, shifts, strict=True)):
            _draw_curve(canvas, energy, shift, left, 2 * MARGIN + row * ROW, longest)
    for row, name in enumerate(names):
        confidence = offsets.confidence[row]
        top = 2 * MARGIN + row * ROW
        _put_text(canvas, name, MARGIN, top + 24, INK)
        text = f"{offsets.frames[row]:+d} frames ({offsets.subframes[row]:+.2f}), confidence {confidence:.0%}"
        _put_text(canvas, text, MARGIN, top + 42, INK if confidence >= 0.1 else WARNING)
    done, content = cv2.imencode(".png", canvas)
    if not done:
        raise RuntimeError(f"{path}: the picture could not be encoded")
    write_bytes_atomically(path, content.tobytes())


def _draw_curve(canvas: Grey, energy: Array, shift: int, left: int, top: int, longest: int) -> None:
    frames = np.arange(len(energy)) - shift
    inside = (frames >= 0) & (frames < longest)
    values = np.log(energy + ENERGY_FLOOR * float(np.median(energy)) + 1e-9)
    span = max(float(values.max() - values.min()), 1e-9)
    y = top + ROW - 6 - (ROW - 12) * (values - values.min()) / span
    x = left + PANEL * frames / max(longest - 1, 1)
    line = np.round(np.column_stack([x, y])[inside]).astype(np.int32).reshape(-1, 1, 2)
    cv2.polylines(canvas, [line], False, (150, 90, 20), 1, cv2.LINE_AA)


def _tick_frames(longest: int) -> int:
    """Frames between grey lines: 1, 2 or 5 times a power of ten, for about ten lines."""
    rough = max(longest / 10, 1)
    power = 10 ** int(np.floor(np.log10(rough)))
    return int(next(power * step for step in (1, 2, 5, 10) if power * step >= rough))


def _put_text(canvas: Grey, text: str, x: int, y: int, colour: tuple[int, int, int]) -> None:
    cv2.putText(canvas, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, 1, cv2.LINE_AA)
