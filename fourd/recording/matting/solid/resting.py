"""Points on a subject that stays where it is between two moments, and the evidence that they give in every frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Array, Camera
from fourd.recording.matting.solid.silhouette import point_silhouette
from fourd.recording.matting.solid.subject import SolidSubject

SOLID_LOG_ODDS = np.float32(3.0)
"""Log-odds of the subject at pixels onto which its points project. One in seven of these pixels shows the background
beside the subject, because stereo compares windows."""
MAX_POINTS = 1 << 22
"""Maximum number of points in a file."""


@dataclass(frozen=True, eq=False)
class RestingParts:
    """The parts of a subject that rest.

    Attributes:
        frames: indices of two or more frames of the recording, in ascending order.
        points: for each pair of successive ``frames``, points (N, 3) in world units that rest between them.
        spacing: largest distance between neighbouring points on a surface, in world units.
    """

    frames: tuple[int, ...]
    points: tuple[Array, ...]
    spacing: float

    @staticmethod
    def of(solid: SolidSubject | None, frames: Sequence[int]) -> RestingParts | None:
        """Return the resting parts of a subject, or None if nothing rests. ``frames`` are the indices of the sampled
        frames in the recording."""
        if solid is None or not sum(len(xyz) for xyz in solid.resting):
            return None
        return RestingParts(tuple(frames[index] for index in solid.moments), solid.resting, solid.spacing)

    def log_odds(self, frame: int, cameras: Sequence[Camera]) -> list[NDArray[np.float32]] | None:
        """Return the log-odds (h, w) in favour of the subject in the image of each camera, or None if nothing rests in
        the frame."""
        spans = zip(self.frames, self.frames[1:], self.points, strict=False)
        shown = [xyz for start, end, xyz in spans if start <= frame <= end and len(xyz)]
        if not shown:
            return None
        masks = [[point_silhouette(xyz, self.spacing, camera) for xyz in shown] for camera in cameras]
        return [np.where(np.any(each, axis=0), SOLID_LOG_ODDS, np.float32(0)) for each in masks]

    def arrays(self) -> dict[str, Any]:
        """Return the arrays from which :meth:`from_arrays` makes the parts again."""
        return {
            "resting_frames": np.array(self.frames, np.int64),
            "resting_counts": np.array([len(xyz) for xyz in self.points], np.int64),
            "resting_points": np.concatenate(self.points).astype(np.float32),
            "resting_spacing": np.array(self.spacing),
        }

    @staticmethod
    def from_arrays(arrays: Mapping[str, Any]) -> RestingParts | None:
        """Return the parts in the arrays of a file, or None if it has none. Raises ValueError for invalid arrays."""
        if "resting_frames" not in arrays:
            return None
        frames, counts = arrays["resting_frames"], arrays["resting_counts"]
        xyz, spacing = arrays["resting_points"], float(arrays["resting_spacing"])
        is_whole = counts.shape == (len(frames) - 1,) and (counts >= 0).all() and xyz.shape == (counts.sum(), 3)
        if not (is_whole and len(xyz) <= MAX_POINTS and np.isfinite(xyz).all() and 0 < spacing < np.inf):
            raise ValueError("resting points of the wrong shape")
        points = np.split(xyz.astype(np.float64), np.cumsum(counts)[:-1])
        return RestingParts(tuple(frames.tolist()), tuple(points), spacing)
