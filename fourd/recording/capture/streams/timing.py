"""The frame rate of a video, computed from the times of its frames."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.recording.capture.frame_rate import STANDARD_RATES, STANDARD_TOLERANCE, standard_rate
from fourd.recording.capture.streams.index import MAX_FPS, MIN_FPS

MAX_JITTER = 0.05
"""Maximum deviation of a frame's time from a constant frame rate, as a fraction of the interval between frames. If any
frame deviates more, the index stores the time of every frame."""
MAX_RATE_ERROR = 5e-3
"""Maximum relative difference at which the mean rate of unevenly spaced frames is replaced by the nearest standard
rate. For videos whose frame times have little jitter, the limit is lower."""
MIN_TICKS = 4
"""Minimum number of ticks between frames at which a deviation by one tick counts as rounding."""


def frame_rate(path: Path, pts: NDArray[np.int64], base: Fraction, declared: Fraction) -> tuple[Fraction, bool]:
    """Compute the frame rate in 1/s from the ascending times of at least 2 frames. Also return whether the times are
    evenly spaced.

    The times ``pts`` are integers in units of ``base`` seconds, the container's time base, so they may be rounded. The
    rate ``declared`` in the header, or 0, is used if it is a standard rate and the times are its rounded times. If the
    times are uneven, as in phone videos, an interval with dropped frames counts as several intervals.

    Raises:
        UserError: if several frames have the same time.
    """
    steps = np.diff(pts)
    if steps.min() <= 0:
        number = int(np.argmax(steps <= 0))
        raise no_times(path, f"frames {number} and {number + 1} at the same time")
    step = Fraction(int(pts[-1] - pts[0]), len(pts) - 1)
    if declared in STANDARD_RATES and step >= MIN_TICKS:
        rounded_times = np.arange(len(pts)) * float(1 / (declared * base))
        if np.abs(pts - pts[0] - rounded_times).max() <= 1:
            return declared, True
    jitter = np.abs(pts - pts[0] - np.arange(len(pts)) * float(step))
    if jitter.max() <= MAX_JITTER * float(step) or (jitter.max() <= 1 and step >= MIN_TICKS):
        exact = 1 / (step * base)
        rounded = _rounded_rate(path, exact)
        # Over many frames, even a small error of the rate would shift the last frames to other numbers.
        return (rounded if abs(rounded / exact - 1) * len(pts) <= MAX_JITTER else exact), True
    # Fit a line to the times as a function of the frame numbers (least squares). Dropped frames are numbered, too.
    numbers = np.cumsum([0, *np.maximum(np.rint(steps / np.median(steps)), 1)])
    (interval, _), covariance = np.polyfit(numbers, pts - pts[0], 1, cov=True)
    # The tolerance for standard rates is 3 times the standard error of the interval, which grows with the jitter.
    error = float(np.sqrt(covariance[0, 0])) / float(interval)
    tolerance = min(max(3 * error, STANDARD_TOLERANCE), MAX_RATE_ERROR)
    rate = 1 / (Fraction(float(interval)) * base)
    return standard_rate(rate, tolerance) if rate >= 1 else _rounded_rate(path, rate), False


def _rounded_rate(path: Path, rate: Fraction) -> Fraction:
    """Round a frame rate in 1/s to a fraction. Its denominator is at most 1001 for rates of at least 1/s; its numerator
    is at most 1001 for rates below 1/s."""
    if not MIN_FPS <= rate <= MAX_FPS:
        raise no_times(path, f"one frame each {float(1 / rate):.3g} s")
    return rate.limit_denominator(1001) if rate >= 1 else 1 / (1 / rate).limit_denominator(1001)


def no_times(path: Path, got: str) -> UserError:
    """Create the error for a video whose frames have no usable times."""
    return UserError(
        f"{path}: expected frames at increasing times, 0.1 ms to 1000 s apart, got {got}; write times of, for example, "
        f"30 frames per second with: ffmpeg -r 30 -i {path.name} -crf 12 timed-{path.name}"
    )
