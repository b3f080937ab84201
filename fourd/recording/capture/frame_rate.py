"""The frame rate of a capture: standard rates, and the file capture.json that stores the rate of a capture."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.limits import read_fraction, read_json
from fourd.recording.capture.layout import camera_folders

NAME = "capture.json"
VERSION = 1
DEFAULT_FPS = 30.0
"""Playback rate in 1/s of captures, runs and scenes whose recording has no known frame rate."""
UNKNOWN_RATE = f"frame rate not known, plays at {DEFAULT_FPS:g} per second"
"""Text that ``fourd check`` and ``fourd info`` print for recordings without a known frame rate."""
MAX_FPS = 1000.0
FPS_IS_FOR_PICTURES = "expected image files, got videos, whose frame times give the rate; omit --fps"
STANDARD_RATES = (
    *(Fraction(rate) for rate in (24, 25, 30, 48, 50, 60, 100, 120, 240)),
    *(Fraction(1000 * rate, 1001) for rate in (24, 30, 48, 60, 120, 240)),
)
STANDARD_TOLERANCE = 2e-4
"""A frame rate is replaced by the nearest standard rate if their relative difference is below this value. For
comparison, 29.97 and 30 differ by 1e-3."""


def standard_rate(fps: float | Fraction, tolerance: float = STANDARD_TOLERANCE) -> Fraction:
    """Return the standard frame rate that is nearest to ``fps``, in 1/s, such as 30000/1001 for 29.97.

    If the relative deviation from the nearest standard rate is above ``tolerance``, the result is ``fps`` as a fraction
    with a denominator of at most 1001.
    """
    nearest = min(STANDARD_RATES, key=lambda rate: abs(rate - Fraction(fps)))
    if abs(float(fps) / float(nearest) - 1) < tolerance:
        return nearest
    return Fraction(fps).limit_denominator(1001)


def check_rate(fps: float | None) -> None:
    """Raise UserError if the value of the option --fps is out of range. None is valid."""
    if fps is not None and not 0.01 <= fps <= MAX_FPS:
        raise UserError(f"--fps: expected 0.01 to {MAX_FPS:g} frames per second, got {fps:g}")


def format_rate(fps: float | Fraction) -> str:
    """Format a frame rate with at most two decimals, such as 29.97."""
    return f"{float(fps):.2f}".rstrip("0").rstrip(".")


def read_rate(capture: Path) -> Fraction | None:
    """Read the frame rate in 1/s from ``capture``/capture.json. Returns None if the file does not exist.

    Raises:
        UserError: if the file is damaged or has a newer version.
    """
    path = capture / NAME
    try:
        content = read_json(path)
        if content["version"] != VERSION:
            raise UserError(f"{path}: expected version {VERSION}, got {content['version']}; update fourd")
        rate = read_fraction(content["fps"])
        if not 0 < rate <= MAX_FPS:
            raise ValueError
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise UserError(f"{path}: expected the frame rate of a capture, got other content; delete the file") from error
    return rate


def set_rate(capture: Path, fps: float) -> None:
    """Store the value of the option --fps as the frame rate of a capture that has image files.

    Raises:
        UserError: if the capture has videos, or the value is out of range.
    """
    check_rate(fps)
    if not camera_folders(capture / "images"):
        raise UserError(f"--fps: {capture}: {FPS_IS_FOR_PICTURES}")
    write_rate(capture, standard_rate(fps))


def write_rate(capture: Path, rate: Fraction) -> None:
    """Write the frame rate in 1/s to ``capture``/capture.json atomically, unless the file already has this rate."""
    if (capture / NAME).exists() and read_rate(capture) == rate:
        return
    write_text_atomically(capture / NAME, json.dumps({"version": VERSION, "fps": str(rate)}, indent=1) + "\n")
