"""Time offsets between cameras without a common trigger, estimated from the motion energy of their images."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from fourd.base.files import write_bytes_atomically
from fourd.recording.sync.pairs import camera_confidence, find_peak, solve_offsets

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

NOISE_SIGMAS = 3.0
ENERGY_FLOOR = 0.1
"""Fraction of the median motion energy that is added to the energy before its logarithm is taken.

The added constant limits how much the logarithm changes at frames without motion.
"""
FINE_SIGMA_FRAMES, COARSE_SIGMA_FRAMES = 1.0, 6.0
"""Standard deviations in frames of the two Gaussians whose difference is the band-pass filter."""
MAX_SIGNAL = 4.0
"""Level, in robust standard deviations, at which the band-passed signal is clipped.

Clipping limits the effect of cuts and flashes that occur in only one camera.
"""
WIDTH_PX = 200
"""Width in pixels to which images are reduced before the motion energy is computed."""
MIN_CONFIDENCE = 0.5
"""An offset is applied or reported only if its confidence is at least this value."""
UNRELIABLE_FRAMES = 3
"""Offsets that are estimated from motion can be wrong by up to this number of frames, so offsets of at most this size
do not prove that the cameras lack a common trigger."""
MIN_OVERLAP = 12
MAX_LAG_ERROR_FRAMES = 1.0
LAG_TOLERANCE_FRAMES = 0.2
NOISE_CORRELATION = 4.0
"""The noise level of a correlation between two signals is this value divided by the square root of the number of
frames.

The noise level is the maximum correlation that two independent signals reach over some tens of lags.
"""

MARGIN, LABEL, PANEL, ROW = 16, 290, 480, 56
INK, GRID, WARNING = (40, 40, 40), (215, 215, 215), (60, 60, 200)


@dataclass(frozen=True, eq=False)
class Offsets:
    """Time offset of each camera's video relative to the first camera's video.

    If a camera has the offset o, an event at frame f of the first camera's video is at frame f + o of this camera's
    video. A camera that starts to record 7 frames after the first camera has o = -7.

    Attributes:
        frames: offsets in whole frames. The offset of the first camera is 0.
        subframes: offsets with fractions of a frame, from parabolas through the peaks of the correlations.
        confidence: confidence of each camera's offset in [0, 1]. How often offsets of a confidence are right depends on
            the recording; docs/lab/calibration.md has measured fractions. For every pair of cameras, the lag is
            estimated, which is the time shift at which their motion energies correlate best. A camera's confidence is
            the mean confidence of the better half of the pairs that include it. A pair's confidence is
            ``min((p1 - c) / (1 - c), 2 * (p1 - p2))``, where p1 is the peak of the correlation of its two signals, p2
            the highest correlation at lags more than 3 frames away from the peak, and c = 4 / sqrt(frames) the noise
            level. A pair's confidence is 0 if its lag differs by more than one frame from the difference of the two
            cameras' offsets.
    """

    frames: tuple[int, ...]
    subframes: tuple[float, ...]
    confidence: tuple[float, ...]


def motion_energy(pictures: Iterable[Grey]) -> Array:
    """Compute the motion energy (F,) of F images: the mean absolute difference, in grey levels, between consecutive
    images.

    Brightness changes of the whole image, such as exposure flicker, are fitted by a gain and an offset, and removed.
    Differences below 3 standard deviations of the noise, which is estimated from the median difference, are set to 0.
    The first image gets the energy of the second image.

    Args:
        pictures: F grey images (H, W) uint8, which are read one after the other. An image width of 200 pixels is
            enough.

    Raises:
        ValueError: if the images differ in size.
    """
    energies = [float(moving.mean()) for moving in moving_pixels(pictures)]
    if len(energies) > 1:
        energies[0] = energies[1]
    return np.array(energies, np.float64)


def moving_pixels(pictures: Iterable[Grey]) -> Iterator[NDArray[np.float32]]:
    """Yield, for each of F grey images (H, W) uint8, the absolute difference (H, W) to the previous image in grey
    levels, without exposure changes and noise; see :func:`motion_energy`. The difference of the first image is 0.

    Raises:
        ValueError: if the images differ in size.
    """
    before: NDArray[np.float32] | None = None
    for picture in pictures:
        now = np.asarray(cv2.GaussianBlur(picture.astype(np.float32), (0, 0), 0.8), np.float32)
        if before is not None and before.shape != now.shape:
            raise ValueError(f"pictures: expected {before.shape} pixels like the previous image, got {now.shape}")
        yield np.zeros_like(now) if before is None else _difference(before, now)
        before = now


def _difference(before: NDArray[np.float32], now: NDArray[np.float32]) -> NDArray[np.float32]:
    gain, offset = _fit_exposure(before.ravel()[::3], now.ravel()[::3])
    difference = np.abs(now - gain * before - offset)
    noise = 1.4826 * float(np.median(difference))
    return np.asarray(np.maximum(difference - NOISE_SIGMAS * noise, 0), np.float32)


def _fit_exposure(before: NDArray[np.float32], now: NDArray[np.float32]) -> tuple[float, float]:
    """Fit ``now = gain * before + offset`` by linear regression. The fit is repeated without the pixels that show
    motion."""
    gain, offset = 1.0, float(np.median(now - before))
    for _ in range(3):
        error = np.abs(now - gain * before - offset)
        still = error <= max(2 * float(np.median(error)), 1.0)
        x, y = before[still], now[still]
        centred = x - x.mean()
        power = float(centred @ centred)
        if power < len(x):
            # If the image has only one grey value, it does not determine the gain.
            return 1.0, float(np.median(now - before))
        gain = float(centred @ y) / power
        offset = float(y.mean() - gain * x.mean())
    return gain, offset


def estimate_offsets(energies: Sequence[Array], max_offset: int) -> Offsets:
    """Estimate the time offset of each camera relative to the first camera, from the motion energies of all cameras.

    The logarithm of each motion energy is band-pass filtered with a difference of Gaussians, which removes gains and
    slow trends. The filtered signals of every pair of cameras are correlated, which gives one lag per pair. The offsets
    are fitted to the lags by iteratively reweighted least squares, which approximates least absolute deviations. In the
    fit, a pair has little weight if its correlation is flat or ambiguous, or if its lag is inconsistent with the lags
    of other pairs.

    For sudden motion, such as claps or steps, the estimate is exact to the frame. For slow and smooth motion, the best
    lag can be wrong by some frames even if the confidence is high, because each camera records a different part of the
    motion. In a recording of a balancing man from four sides at 60 Hz, the error was up to 3 frames, so an offset of up
    to 3 frames does not prove that the cameras lack a common trigger.

    Args:
        energies: result (F,) of :func:`motion_energy` for each camera. The number of frames F may differ between
            cameras.
        max_offset: maximum offset in frames, at least 1. Two videos that are shifted by ``max_offset`` must overlap in
            at least 12 frames.

    Raises:
        ValueError: if there is no camera, or if there are too few frames for ``max_offset``.
    """
    if not energies or max_offset < 1:
        raise ValueError(
            f"expected at least 1 camera and max_offset of at least 1, got {len(energies)} cameras and {max_offset}"
        )
    shortest = min(len(energy) for energy in energies)
    if shortest - max_offset < MIN_OVERLAP:
        limit = max(shortest - MIN_OVERLAP, 0)
        raise ValueError(f"max_offset: expected at most {limit} for videos of {shortest} frames, got {max_offset}")
    signals = [_bandpass(energy) for energy in energies]
    pairs = list(combinations(range(len(signals)), 2))
    found = [_estimate_lag(signals[i], signals[j], max_offset) for i, j in pairs]
    lags = np.array([lag for lag, _ in found])
    weights = np.array([weight for _, weight in found])
    solution = solve_offsets(pairs, lags, weights, len(signals), LAG_TOLERANCE_FRAMES)
    agrees = np.array(
        [abs(solution[j] - solution[i] - lag) <= MAX_LAG_ERROR_FRAMES for (i, j), lag in zip(pairs, lags, strict=True)]
    )
    agreed = list(zip(weights * agrees, pairs, strict=True))
    confidence = [camera_confidence([q for q, pair in agreed if camera in pair]) for camera in range(len(signals))]
    return Offsets(tuple(round(float(o)) for o in solution), tuple(map(float, solution)), tuple(confidence))


def _bandpass(energy: Array) -> Array:
    """Compute the logarithm of the motion energy, and then filter it with the band-pass filter, normalise it and clip
    it. Returns the signal (F,), which is 0 if the energy is constant."""
    level = ENERGY_FLOOR * float(np.median(energy)) + 1e-3 * float(np.max(energy, initial=0)) + 1e-9
    logarithm = np.log(energy + level)
    band = gaussian_filter1d(logarithm, FINE_SIGMA_FRAMES) - gaussian_filter1d(logarithm, COARSE_SIGMA_FRAMES)
    scale = 1.4826 * float(np.median(np.abs(band)))
    scale = scale if scale > 1e-9 else float(band.std())
    return np.clip(band / scale, -MAX_SIGNAL, MAX_SIGNAL) if scale > 1e-9 else np.zeros_like(band)


def _estimate_lag(first: Array, second: Array, max_lag: int) -> tuple[float, float]:
    """Find the lag, in frames with sub-frame accuracy, at which ``second[f + lag]`` correlates best with ``first[f]``.

    Returns:
        the lag, and the weight in [0, 1] that this pair of cameras has in the fit of the offsets.
    """
    scores = np.array([_correlation(first, second, lag) for lag in range(-max_lag, max_lag + 1)])
    peak = find_peak(scores)
    noise = NOISE_CORRELATION / np.sqrt(min(len(first), len(second)))
    weight = float(np.clip(min((peak.height - noise) / max(1 - noise, 1e-9), 2 * peak.lead), 0, 1))
    return peak.position - max_lag, weight


def _correlation(first: Array, second: Array, lag: int) -> float:
    start, end = max(0, -lag), min(len(first), len(second) - lag)
    x, y = first[start:end], second[start + lag : end + lag]
    x, y = x - x.mean(), y - y.mean()
    norm = float(np.sqrt((x @ x) * (y @ y)))
    return float(x @ y) / norm if norm > 1e-9 else 0.0


def plot_offsets(path: Path | str, names: Sequence[str], energies: Sequence[Array], offsets: Offsets) -> None:
    """Write a PNG plot of all motion energies, atomically. The left panel shows the energies as recorded, and the right
    panel shows them shifted by the offsets.

    Each camera has a row with its name, offset and confidence. Confidences below 0.1 are printed in red. Each row has a
    separate, logarithmic vertical scale. Vertical grey lines mark the same frame numbers in both panels.
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
        raise RuntimeError(f"{path}: the image could not be encoded")
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
    """Return the number of frames between two grey lines: 1, 2 or 5 times a power of ten, such that the plot has about
    ten lines."""
    rough = max(longest / 10, 1)
    power = 10 ** int(np.floor(np.log10(rough)))
    return int(next(power * step for step in (1, 2, 5, 10) if power * step >= rough))


def _put_text(canvas: Grey, text: str, x: int, y: int, colour: tuple[int, int, int]) -> None:
    cv2.putText(canvas, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, 1, cv2.LINE_AA)
