"""Time offsets between cameras that no common clock triggers, from how much moves in each picture."""

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
FLOOR = 0.1
"""Of the median energy, added before the logarithm, so that stillness does not become a cliff."""
FINEST_FRAMES, COARSEST_FRAMES = 1.0, 6.0
"""Scales of the changes that are correlated: a derivative over few frames, without the noise of one over a single."""
CLIPPED_AT = 4.0
"""Scales of a signal beyond which a jump counts no more: cuts and flashes are one camera's own."""
PEAK_REACH = 3
LEAST_OVERLAP = 12
AGREEMENT_FRAMES = 1.0
CHANCE = 4.0
"""Over the square root of the number of frames: a correlation that noise reaches among some tens of lags."""

MARGIN, LABEL, PANEL, ROW = 16, 250, 480, 56
INK, QUIET, WEAK = (40, 40, 40), (215, 215, 215), (60, 60, 200)


@dataclass(frozen=True, eq=False)
class Offsets:
    """By how much each camera runs behind the first.

    An offset o of a camera means that the capture's frame f is this camera's video's frame f + o:
    what happens at frame f of the first camera is seen at frame f + o here. A camera that started
    to record 7 frames too late lacks its first 7, and has o = -7.

    Attributes:
        frames: whole frames; 0 for the first camera.
        subframes: the same with fractions, from parabolas through the correlations' peaks.
        confidence: in [0, 1]. With p1 the peak of a pair's correlation, p2 the highest one more than
            3 frames away from it and c = 4 / sqrt(frames) what noise reaches, the pair's trust is the less
            of (p1 - c) / (1 - c) and 2 (p1 - p2), and 0 where its lag is not the solution's to a frame;
            a camera has the mean of the better half of its pairs.
            Above 0.3 is good; below 0.1 the offset is a guess.
    """

    frames: tuple[int, ...]
    subframes: tuple[float, ...]
    confidence: tuple[float, ...]


def motion_energy(pictures: Iterable[Grey]) -> Array:
    """(F,) how much each picture differs from the one before, in grey levels; the first has the second's value.

    The pictures (H, W) are uint8, small ones do (200 pixels wide, say), and are read one at a time.
    What changes all of a picture, a flicker of exposure, is taken out as a gain and a shift; of the
    rest what is within 3 standard deviations of the noise counts nothing, the noise being judged
    from the picture's unmoved half.

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
    gain, shift = _exposure(before.ravel()[::3], now.ravel()[::3])
    size = np.abs(now - gain * before - shift)
    noise = 1.4826 * float(np.median(size))
    return float(np.maximum(size - NOISE_SIGMAS * noise, 0).mean())


def _exposure(before: NDArray[np.float32], now: NDArray[np.float32]) -> tuple[float, float]:
    """Gain and shift that turn most of ``before`` into ``now``: a line, fitted again without what moved."""
    gain, shift = 1.0, float(np.median(now - before))
    for _ in range(3):
        error = np.abs(now - gain * before - shift)
        still = error <= max(2 * float(np.median(error)), 1.0)
        here, there = before[still], now[still]
        spread = here - here.mean()
        power = float(spread @ spread)
        if power < len(here):
            # A picture of one grey tells no gain.
            return 1.0, float(np.median(now - before))
        gain = float(spread @ there) / power
        shift = float(there.mean() - gain * here.mean())
    return gain, shift


def estimate_offsets(energies: Sequence[Array], most: int) -> Offsets:
    """Estimate by how many frames cameras run behind the first, from :func:`motion_energy` of each.

    The changes of the energies' logarithms (differences of two Gaussians, so that gains and slow
    trends drop out) are correlated for every pair of cameras; all lags together give the offsets by
    weighted least squares, reweighted towards least absolute deviations, so that pairs whose
    correlation is flat, ambiguous or at odds with the others count little.

    Cameras see different parts of a movement: where it is slow and smooth, even the best lag is off
    by some frames (up to 3 at 60 Hz on a man who balances, seen from four sides), and no confidence
    tells this. Sudden movements, claps or steps, are what makes it exact. An offset of 3 frames or
    less is no proof that cameras were not triggered together.

    Args:
        energies: (F,) of each camera; lengths may differ.
        most: frames that an offset may be, at least 1; 12 frames at least must overlap.

    Raises:
        ValueError: when there is no camera, or too few frames for ``most``.
    """
    if not energies or most < 1:
        raise ValueError(f"expected at least 1 camera and 1 frame, got {len(energies)} and {most}")
    shortest = min(len(energy) for energy in energies)
    if shortest - most < LEAST_OVERLAP:
        raise ValueError(f"most: expected at most {max(shortest - LEAST_OVERLAP, 0)} frames of {shortest}, got {most}")
    signals = [_changes(energy) for energy in energies]
    pairs = list(combinations(range(len(signals)), 2))
    found = [_lag(signals[i], signals[j], most) for i, j in pairs]
    lags = np.array([lag for lag, _ in found])
    trust = np.array([trust for _, trust in found])
    solution = _solve(pairs, lags, trust, len(signals))
    agrees = np.array(
        [abs(solution[j] - solution[i] - lag) <= AGREEMENT_FRAMES for (i, j), lag in zip(pairs, lags, strict=True)]
    )
    agreed = list(zip(trust * agrees, pairs, strict=True))
    confidence = [_confidence([q for q, pair in agreed if camera in pair]) for camera in range(len(signals))]
    return Offsets(tuple(round(float(o)) for o in solution), tuple(map(float, solution)), tuple(confidence))


def _confidence(trusts: Sequence[float]) -> float:
    """Mean of the better half; a single camera is sure to be in time with itself."""
    better = sorted(trusts, reverse=True)[: (len(trusts) + 1) // 2]
    return float(np.mean(better)) if better else 1.0


def _changes(energy: Array) -> Array:
    """(F,) clipped band of the log energy, of unit scale; zeros where nothing ever changes."""
    level = FLOOR * float(np.median(energy)) + 1e-3 * float(np.max(energy, initial=0)) + 1e-9
    logarithm = np.log(energy + level)
    steps = gaussian_filter1d(logarithm, FINEST_FRAMES) - gaussian_filter1d(logarithm, COARSEST_FRAMES)
    scale = 1.4826 * float(np.median(np.abs(steps)))
    scale = scale if scale > 1e-9 else float(steps.std())
    return np.clip(steps / scale, -CLIPPED_AT, CLIPPED_AT) if scale > 1e-9 else np.zeros_like(steps)


def _lag(first: Array, second: Array, most: int) -> tuple[float, float]:
    """The lag at which ``second[f + lag]`` goes with ``first[f]``, to a fraction of a frame, and its trust."""
    scores = np.array([_correlation(first, second, lag) for lag in range(-most, most + 1)])
    top = int(scores.argmax())
    peak = float(scores[top])
    others = np.delete(scores, np.arange(max(top - PEAK_REACH, 0), min(top + PEAK_REACH + 1, len(scores))))
    chance = CHANCE / np.sqrt(min(len(first), len(second)))
    lead = 2 * (peak - max(float(others.max(initial=0)), 0.0))
    trust = float(np.clip(min((peak - chance) / max(1 - chance, 1e-9), lead), 0, 1))
    fraction = 0.0
    if 0 < top < len(scores) - 1:
        left, right = float(scores[top - 1]), float(scores[top + 1])
        bend = left - 2 * peak + right
        fraction = 0.5 * (left - right) / bend if bend < -1e-12 else 0.0
    return top - most + fraction, trust


def _correlation(first: Array, second: Array, lag: int) -> float:
    start, end = max(0, -lag), min(len(first), len(second) - lag)
    here, there = first[start:end], second[start + lag : end + lag]
    here, there = here - here.mean(), there - there.mean()
    size = float(np.sqrt((here @ here) * (there @ there)))
    return float(here @ there) / size if size > 1e-9 else 0.0


def _solve(pairs: Sequence[tuple[int, int]], lags: Array, trust: Array, count: int) -> Array:
    """(count,) offsets, the first 0, whose differences are nearest to the lags; 0 where nothing is trusted."""
    if not pairs:
        return np.zeros(count)
    design = np.zeros((len(pairs), count))
    for row, (i, j) in enumerate(pairs):
        design[row, i], design[row, j] = -1, 1
    design = design[:, 1:]
    weights = trust**2 + 1e-9
    solution: Array = np.zeros(count - 1)
    for _ in range(30):
        root = np.sqrt(weights)
        solution = np.asarray(np.linalg.lstsq(root[:, None] * design, root * lags, rcond=None)[0], np.float64)
        weights = (trust**2 + 1e-9) / np.maximum(np.abs(design @ solution - lags), 0.2)
    return np.concatenate([[0.0], solution])


def plot_offsets(path: Path | str, names: Sequence[str], energies: Sequence[Array], offsets: Offsets) -> None:
    """Write a PNG of all energies, as recorded (left) and shifted into the capture's time (right), atomically.

    Each camera has a row with its name, offset and confidence, red where that is below 0.1. Rows are
    scaled each by itself. The grey lines are the same frames on both sides.
    """
    height = 3 * MARGIN + ROW * len(names) + MARGIN
    canvas = np.full((height, LABEL + 2 * (PANEL + MARGIN) + MARGIN, 3), 255, np.uint8)
    longest = max(len(energy) for energy in energies)
    panels = (("as recorded", LABEL, [0] * len(names)), ("shifted", LABEL + PANEL + MARGIN, offsets.frames))
    for title, left, shifts in panels:
        _write(canvas, f"{title}, frames 0 to {longest - 1}", left, 2 * MARGIN - 8, INK)
        for frame in range(0, longest, _tick(longest)):
            x = left + round(PANEL * frame / max(longest - 1, 1))
            cv2.line(canvas, (x, 2 * MARGIN), (x, height - 2 * MARGIN), QUIET, 1)
            _write(canvas, str(frame), x - 6, height - MARGIN + 4, INK)
        for row, (energy, shift) in enumerate(zip(energies, shifts, strict=True)):
            _curve(canvas, energy, shift, left, 2 * MARGIN + row * ROW, longest)
    for row, name in enumerate(names):
        sure = offsets.confidence[row]
        top = 2 * MARGIN + row * ROW
        _write(canvas, name, MARGIN, top + 24, INK)
        text = f"{offsets.frames[row]:+d} frames ({offsets.subframes[row]:+.2f}), {sure:.0%} sure"
        _write(canvas, text, MARGIN, top + 42, INK if sure >= 0.1 else WEAK)
    done, content = cv2.imencode(".png", canvas)
    if not done:
        raise RuntimeError(f"{path}: the picture could not be encoded")
    write_bytes_atomically(path, content.tobytes())


def _curve(canvas: Grey, energy: Array, shift: int, left: int, top: int, longest: int) -> None:
    frames = np.arange(len(energy)) - shift
    inside = (frames >= 0) & (frames < longest)
    values = np.log(energy + FLOOR * float(np.median(energy)) + 1e-9)
    span = max(float(values.max() - values.min()), 1e-9)
    y = top + ROW - 6 - (ROW - 12) * (values - values.min()) / span
    x = left + PANEL * frames / max(longest - 1, 1)
    line = np.round(np.column_stack([x, y])[inside]).astype(np.int32).reshape(-1, 1, 2)
    cv2.polylines(canvas, [line], False, (150, 90, 20), 1, cv2.LINE_AA)


def _tick(longest: int) -> int:
    """Frames between grey lines: 1, 2 or 5 times a power of ten, about ten lines."""
    rough = max(longest / 10, 1)
    power = 10 ** int(np.floor(np.log10(rough)))
    return int(next(power * step for step in (1, 2, 5, 10) if power * step >= rough))


def _write(canvas: Grey, text: str, x: int, y: int, colour: tuple[int, int, int]) -> None:
    cv2.putText(canvas, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.42, colour, 1, cv2.LINE_AA)
