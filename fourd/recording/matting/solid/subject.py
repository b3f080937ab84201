"""Points on the subject at a few moments, and what follows from them: its extent and its silhouettes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Array, Camera
from fourd.recording.matting.solid.moments import Moments
from fourd.recording.matting.solid.silhouette import point_silhouette
from fourd.recording.matting.solid.subject_points import find_subject_points, reach

Flags = NDArray[np.bool_]

BOX_MARGIN = 0.05
"""Margin of the box around the points, as a fraction of the box's longest side."""
OUTLIERS = 0.02
"""Fraction of the points that may lie outside the box, in each direction, and outside the images of too many views."""
MAX_SEEING = 0.75
SPACING_SHARE = 0.02
"""Largest distance between neighbouring points on the subject, as a fraction of the median distance of the cameras from
their focus."""


@dataclass(frozen=True, eq=False)
class SolidSubject:
    """Points on the subject, measured by stereo.

    Attributes:
        moments: indices of the sampled frames in which the points were measured.
        points: one array (N, 3) for each moment, in world units.
        resting: one array (N, 3) for each moment but the last: points that stay until the next moment.
        spacing: largest distance between neighbouring points on a surface, in world units.
    """

    moments: tuple[int, ...]
    points: tuple[Array, ...]
    resting: tuple[Array, ...]
    spacing: float

    @staticmethod
    def from_moments(moments: Moments, cameras: Sequence[Camera], regions: Sequence[Flags]) -> SolidSubject | None:
        """Choose the subject's points among those of all surfaces; see :func:`find_subject_points`.

        Returns:
            the subject, or None if no point belongs to it.
        """
        found = find_subject_points(moments.points, cameras, regions)
        if not sum(len(xyz) for xyz in found.moments):
            return None
        return SolidSubject(moments.frames, found.moments, found.resting, SPACING_SHARE * reach(cameras))

    def extend(self, box: tuple[Array, Array]) -> tuple[Array, Array]:
        """Return the smallest box, given by two corners (3,), that contains ``box`` and the points with a margin."""
        everything = np.concatenate(self.points)
        lower, upper = np.quantile(everything, (OUTLIERS / 2, 1 - OUTLIERS / 2), axis=0)
        margin = BOX_MARGIN * float((upper - lower).max())
        return np.minimum(box[0], lower - margin), np.maximum(box[1], upper + margin)

    def covered_share(self, box: tuple[Array, Array], cameras: Sequence[Camera], regions: Sequence[Flags]) -> float:
        """Return the fraction of the points that lie in ``box`` and, in a camera that sees them, in its region (h, w);
        mean over all cameras and points."""
        everything = np.concatenate(self.points)
        in_box = np.asarray(((everything >= box[0]) & (everything <= box[1])).all(axis=1), np.bool_)
        seen = covered = 0
        for camera, region in zip(cameras, regions, strict=True):
            pixels, depth = camera.project(everything)
            inside = camera.is_in_image(pixels, depth)
            column, row = pixels[inside].astype(np.intp).T
            seen += int(inside.sum())
            covered += int((in_box[inside] & region[row, column]).sum())
        return covered / max(1, seen)

    def seeing_share(self, cameras: Sequence[Camera]) -> float:
        """Return a fraction of the cameras, such that nearly all points are inside the images of at least as many."""
        everything = np.concatenate(self.points)
        seen = np.mean([camera.is_in_image(*camera.project(everything)) for camera in cameras], axis=0)
        return min(MAX_SEEING, float(np.quantile(seen, OUTLIERS)))

    def silhouettes(self, camera: Camera, count: int) -> Flags:
        """Return the masks (count, h, w) of the pixels that the points cover, one for each sampled frame.

        In a frame between two moments, these are the points that rest. Frames without points have empty masks.
        """
        masks = np.zeros((count, camera.height, camera.width), np.bool_)
        for start, end, xyz in zip(self.moments, self.moments[1:], self.resting, strict=False):
            masks[start + 1 : end] = point_silhouette(xyz, self.spacing, camera)
        for frame, xyz in zip(self.moments, self.points, strict=True):
            masks[frame] = point_silhouette(xyz, self.spacing, camera)
        return masks
