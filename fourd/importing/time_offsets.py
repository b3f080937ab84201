"""Time offsets between a source's cameras, estimated from downscaled grey images of all frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.capture.layout import DERIVED
from fourd.capture.video import VideoIndex
from fourd.errors import UserError
from fourd.importing.imported import ImportedCamera
from fourd.importing.sample_frames import SynchronizedFrames
from fourd.progress import Track
from fourd.sync.motion import MIN_OVERLAP, Offsets, estimate_offsets, motion_energy, plot_offsets

WIDTH_PX = 200
MAX_OFFSET_FRAMES = 300
MIN_CONFIDENCE = 0.5
"""Minimum confidence of an offset that --apply-sync applies."""
UNRELIABLE_FRAMES = 3
"""Error of the estimated offsets in frames. --apply-sync applies only offsets above this error."""
PLOT = DERIVED / "sync.png"


def find_offsets(
    cameras: tuple[ImportedCamera, ...], indices: Mapping[str, VideoIndex], out: Path, track: Track
) -> Offsets:
    """Estimate the delay of each camera relative to the first camera, and plot the delays to ``out``/.fourd/sync.png.

    The maximum offset is a third of the number of frames that all cameras have, and at most 300 frames.

    Raises:
        UserError: when there are too few frames, or a frame cannot be decoded.
    """
    with SynchronizedFrames(cameras, indices, {}) as frames:
        max_offset = min(frames.count // 3, frames.count - MIN_OVERLAP, MAX_OFFSET_FRAMES)
        if max_offset < 1:
            raise UserError(
                f"--sync: expected more than {MIN_OVERLAP} frames per camera, got {frames.count}; use --offset instead"
            )
        energies = []
        for index, name in enumerate(frames.names):
            numbers = track(range(frames.counts[index]), frames.counts[index], f"motion of {name}")
            energies.append(motion_energy(_reduced_frames(frames, index, numbers)))
    found = estimate_offsets(energies, max_offset)
    plot_offsets(out / PLOT, frames.names, energies, found)
    return found


def confident_offsets(names: Iterable[str], found: Offsets) -> dict[str, int]:
    """Select the offsets of more than 3 frames that have a confidence of at least 0.5, by camera name."""
    return {
        name: frames
        for name, frames, confidence in zip(names, found.frames, found.confidence, strict=True)
        if confidence >= MIN_CONFIDENCE and abs(frames) > UNRELIABLE_FRAMES
    }


def _reduced_frames(frames: SynchronizedFrames, index: int, numbers: Iterable[int]) -> Iterator[NDArray[np.uint8]]:
    for number in numbers:
        grey = cv2.cvtColor(frames.picture(index, number), cv2.COLOR_RGB2GRAY)
        height = max(1, round(grey.shape[0] * WIDTH_PX / grey.shape[1]))
        yield np.asarray(cv2.resize(grey, (WIDTH_PX, height), interpolation=cv2.INTER_AREA), np.uint8)
