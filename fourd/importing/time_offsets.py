"""Time offsets of an import's cameras, estimated from small grey pictures of all their frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.capture.video import VideoIndex
from fourd.errors import UserError
from fourd.importing.formats.imported import ImportedCamera
from fourd.importing.sample_frames import Moments
from fourd.progress import Track
from fourd.sync.motion import LEAST_OVERLAP, Offsets, estimate_offsets, motion_energy, plot_offsets

WIDTH = 200
MOST = 300
SURE = 0.5
"""Confidence from which an offset is applied."""
NO_PROOF = 3
"""Frames up to which an offset may be the method's own error."""
PLOT = Path(".fourd") / "sync.png"


def find_offsets(
    cameras: tuple[ImportedCamera, ...], indices: Mapping[str, VideoIndex], out: Path, track: Track
) -> Offsets:
    """Estimate by how many frames cameras run behind the first, and plot it as ``out``/.fourd/sync.png.

    Offsets up to a third of the shortest camera's frames are looked for, and 300 at most.

    Raises:
        UserError: when there are too few frames, or one of them cannot be decoded.
    """
    with Moments(cameras, indices, {}) as moments:
        most = min(moments.count // 3, moments.count - LEAST_OVERLAP, MOST)
        if most < 1:
            raise UserError(
                f"--sync: expected more than {LEAST_OVERLAP} frames of each camera, got {moments.count}; use --offset"
            )
        energies = []
        for index, name in enumerate(moments.names):
            numbers = track(range(moments.counts[index]), moments.counts[index], f"motion of {name}")
            energies.append(motion_energy(_small(moments, index, numbers)))
    found = estimate_offsets(energies, most)
    plot_offsets(out / PLOT, moments.names, energies, found)
    return found


def sure_offsets(names: Iterable[str], found: Offsets) -> dict[str, int]:
    """The offsets to apply: those of more than 3 frames whose confidence is at least 0.5."""
    return {
        name: frames
        for name, frames, sure in zip(names, found.frames, found.confidence, strict=True)
        if sure >= SURE and abs(frames) > NO_PROOF
    }


def _small(moments: Moments, index: int, numbers: Iterable[int]) -> Iterator[NDArray[np.uint8]]:
    for number in numbers:
        grey = cv2.cvtColor(moments.picture(index, number), cv2.COLOR_RGB2GRAY)
        height = max(1, round(grey.shape[0] * WIDTH / grey.shape[1]))
        yield np.asarray(cv2.resize(grey, (WIDTH, height), interpolation=cv2.INTER_AREA), np.uint8)
