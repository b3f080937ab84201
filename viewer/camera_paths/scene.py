"""What a camera path needs to know of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.scene.playable import Bounds


@dataclass(frozen=True, eq=False)
class PathScene:
    """A scene along whose frames a camera moves.

    Attributes:
        cameras: cameras of the capture; empty if the scene has none.
        focus: (3,) centre of the scene in world units.
        frame_count: number of frames, at least 1.
        fps: frames per second of the scene.
        bounds: lower and upper corner of the box around the subject, or None if it is not known.
        is_whole: whether the scene has surroundings, and not only a subject.
    """

    cameras: Sequence[Camera]
    focus: NDArray[np.float64]
    frame_count: int
    fps: float
    bounds: Bounds | None = None
    is_whole: bool = False

    def frame_at(self, time: float) -> float:
        """Return the index of the frame, which can be fractional, at a time from 0 (first frame) to 1 (last frame).
        Times beyond this range are clamped."""
        return float(np.clip(time, 0, 1)) * (self.frame_count - 1)

    def time_of(self, frame: float) -> float:
        """Return the time, from 0 to 1, of a frame index."""
        return float(np.clip(frame / max(self.frame_count - 1, 1), 0, 1))
