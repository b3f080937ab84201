"""Choice of the image files that a check of a capture decodes to find damaged ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

import numpy as np

from fourd.base.progress import Track

PROBES = 12
"""Number of files that are decoded to estimate how long decoding all files takes."""
SAMPLE_SECONDS = 15.0
"""If decoding all files takes too long, a sample is decoded. The sample takes about this number of seconds."""


@dataclass(frozen=True)
class Skipped:
    """The files that a check did not decode.

    Attributes:
        count: number of these files.
        total: number of all files.
        seconds: estimated time that decoding all files takes.
    """

    count: int
    total: int
    seconds: float

    def __str__(self) -> str:
        return (
            f"{self.total - self.count} of {self.total} files were decoded to find damaged ones; decoding all takes "
            f"about {_duration(self.seconds)}: add --deep"
        )


def decode_pictures(
    files: Sequence[Path], decode: Callable[[Path], object], max_seconds: float, track: Track
) -> Skipped | None:
    """Decode all files, or an even sample of them if all files probably take more than ``max_seconds``.

    Args:
        files: the files.
        decode: decodes one file and handles its errors.
        max_seconds: limit of the estimated time. If it is 0, no file is decoded.
        track: progress callback.

    Returns:
        the number of files that were not decoded, or None if all were decoded or ``max_seconds`` is 0.
    """
    if not files or max_seconds <= 0:
        return None
    # The order is random, so that every prefix is a sample of all cameras and frames. The seed makes the choice the
    # same in every run.
    order = np.random.default_rng(0).permutation(len(files))
    start = monotonic()
    for index in order[:PROBES]:
        decode(files[index])
    probes = min(PROBES, len(files))
    per_file = (monotonic() - start) / probes
    seconds = per_file * len(files)
    rest = order[PROBES:]
    if seconds > max_seconds:
        rest = rest[: max(0, int(SAMPLE_SECONDS / per_file) - probes)]
    for index in track(np.sort(rest).tolist(), len(rest), "decoding"):
        decode(files[index])
    count = len(files) - probes - len(rest)
    return Skipped(count, len(files), seconds) if count else None


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} minutes"
