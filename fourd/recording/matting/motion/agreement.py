"""Multi-view consistency: a soft visual hull for each view, computed from the evidence of all other views.

The evidence of a view is an image of log-odds that a pixel shows the subject. A voxel's log-odds in a view are the
largest log-odds within the voxel's projection. A voxel's score is the smallest of its log-odds over the views in which
the voxel is visible. With many views, a slightly larger value is used instead, for example the second smallest, so that
a few views may be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Array, Camera

Floats = NDArray[np.float32]

MAX_CELLS = 112
"""Maximum number of voxels along the longest side of the grid's box. With this limit, the grid of a cubic box has 1.4
million voxels."""
CELLS_PER_PIXEL = 1.0
OUTLIER_SHARE = 0.05
"""Maximum fraction of the views that may be wrong about a voxel: the voxel's score ignores its lowest log-odds in this
fraction of the views."""
MIN_SEEING_SHARE = 0.75
"""Default of :attr:`VoxelGrid.min_seeing`."""
REJECT_LOG_ODDS = np.float32(-2.0)
"""A view rejects a voxel if the voxel's log-odds in the view are below this value. Voxels that too many views reject
are removed, so that the log-odds of only a few voxels must be sorted."""
NO_CELL_LOG_ODDS = np.float32(-9.0)
"""Log-odds of pixels onto which no voxel projects."""


@dataclass(frozen=True, eq=False)
class VoxelGrid:
    """A grid of voxels with their projections into each camera.

    Attributes:
        xyz: (N, 3) voxel centres in world units.
        size: side of a voxel in world units.
        cameras: the C cameras from whose log-odds the voxels' scores are computed.
        pixels: (C, N) int32 flat pixel index, row * width + column, of each voxel centre in each camera, or -1 if the
            voxel centre is outside the image.
        width_px: (C,) width of a voxel's projection in each camera, rounded to an odd number of pixels.
        min_seeing: a voxel gets a score only if it is inside the images of at least this fraction of the views.
    """

    xyz: Array
    size: float
    cameras: tuple[Camera, ...]
    pixels: NDArray[np.int32]
    width_px: tuple[int, ...]
    min_seeing: float = MIN_SEEING_SHARE

    @staticmethod
    def covering(
        lower: Array,
        upper: Array,
        cameras: Sequence[Camera],
        count: int | None = None,
        min_seeing: float = MIN_SEEING_SHARE,
    ) -> VoxelGrid:
        """Create a grid over a box.

        Args:
            lower: (3,) minimum corner of the box in world units.
            upper: (3,) maximum corner of the box in world units.
            cameras: cameras from whose log-odds the voxels' scores are computed.
            count: number of voxels along the box's longest side, or None to match the images' resolution.
            min_seeing: the least fraction of the views that see a voxel.
        """
        side = float((upper - lower).max())
        if count is None:
            middle = (lower + upper) / 2
            distances = [float(np.linalg.norm(camera.centre - middle)) for camera in cameras]
            focals = [camera.intrinsics[1, 1] for camera in cameras]
            side_px = side * max(focal / distance for focal, distance in zip(focals, distances, strict=True))
            count = int(np.clip(CELLS_PER_PIXEL * side_px, 16, MAX_CELLS))
        size = side / count
        axes = [np.arange(low + size / 2, high, size) for low, high in zip(lower, upper, strict=True)]
        xyz = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        return VoxelGrid.from_centres(xyz, size, cameras, min_seeing)

    @staticmethod
    def from_centres(
        xyz: Array, size: float, cameras: Sequence[Camera], min_seeing: float = MIN_SEEING_SHARE
    ) -> VoxelGrid:
        """Create a grid by projecting voxels with centres (N, 3) into the cameras."""
        pixels = np.full((len(cameras), len(xyz)), -1, np.int32)
        widths = []
        for index, camera in enumerate(cameras):
            position, depth = camera.project(xyz)
            column, row = np.floor(position[:, 0]), np.floor(position[:, 1])
            seen = (depth > 0) & (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
            pixels[index, seen] = (row[seen] * camera.width + column[seen]).astype(np.int32)
            median = float(np.median(depth[seen])) if seen.any() else np.inf
            width = camera.intrinsics[1, 1] * size / median
            widths.append(2 * round((width - 1) / 2) + 1 if width > 1 else 1)
        return VoxelGrid(xyz, size, tuple(cameras), pixels, tuple(widths), min_seeing)

    def scores(self, evidence: Sequence[Floats]) -> Scores:
        """Score the voxels. ``evidence`` has one image (h, w) of log-odds per camera; positive log-odds are the
        subject."""
        seen = (self.pixels >= 0).sum(axis=0)
        needed = max(2, int(np.ceil(self.min_seeing * len(self.cameras) - 1e-9)))
        outliers = min(int(OUTLIER_SHARE * len(self.cameras) + 1e-9), max(0, len(self.cameras) - 2))
        alive = np.flatnonzero(seen >= needed)
        rejections = np.zeros(len(alive), np.int16)
        values: list[Floats] = []
        for index, picture in enumerate(evidence):
            flat = dilate(picture, self.width_px[index]).ravel()
            pixels = self.pixels[index, alive]
            value = np.where(pixels >= 0, flat[np.maximum(pixels, 0)], -NO_CELL_LOG_ODDS)
            values.append(value)
            rejections += value < REJECT_LOG_ODDS
            keep = rejections <= outliers + 1
            if np.count_nonzero(keep) < 0.7 * len(keep):
                alive, rejections = alive[keep], rejections[keep]
                values = [kept[keep] for kept in values]
        keep = rejections <= outliers + 1
        stacked = np.stack([kept[keep] for kept in values])
        return Scores.from_evidence(self, alive[keep], stacked, outliers)

    def max_projection(self, chosen: NDArray[np.intp], values: Floats, index: int) -> Floats:
        """Project the ``chosen`` voxels into camera ``index``. Each pixel gets the largest of the ``values`` of the
        voxels that project onto it.

        Returns an array (h, w). A morphological closing fills small gaps between the projected voxel centres. All other
        pixels onto which no voxel projects have the value NO_CELL_LOG_ODDS.
        """
        camera = self.cameras[index]
        flat = np.full(camera.width * camera.height, NO_CELL_LOG_ODDS, np.float32)
        pixels = self.pixels[index, chosen]
        seen = pixels >= 0
        np.maximum.at(flat, pixels[seen], values[seen])
        picture = flat.reshape(camera.height, camera.width)
        return np.asarray(cv2.morphologyEx(picture, cv2.MORPH_CLOSE, _square(max(3, self.width_px[index]))), np.float32)


@dataclass(frozen=True, eq=False)
class Scores:
    """Scores of the voxels that are not rejected.

    Attributes:
        grid: the voxel grid.
        alive: (n,) indices of the voxels that are not rejected.
        total: (n,) scores from all views.
        leave_one_out: (C, n) scores. Row c is computed from all views except the view of camera c.
    """

    grid: VoxelGrid
    alive: NDArray[np.intp]
    total: Floats
    leave_one_out: Floats

    @staticmethod
    def from_evidence(grid: VoxelGrid, alive: NDArray[np.intp], values: Floats, outliers: int) -> Scores:
        """Compute scores as order statistics of the log-odds ``values`` (C, n) over the C views.

        Each voxel's ``outliers`` lowest log-odds are ignored, because up to ``outliers`` views may be wrong about it.
        """
        if len(values) == 1:
            return Scores(grid, alive, values[0], np.full_like(values, -NO_CELL_LOG_ODDS))
        lowest = np.sort(np.partition(values, outliers + 1, axis=0)[: outliers + 2], axis=0)
        total, following = lowest[outliers], lowest[outliers + 1]
        leave_one_out = np.where(values <= total, following, total)
        return Scores(grid, alive, total, leave_one_out)

    def prior(self, index: int) -> Floats:
        """Return the log-odds (h, w) of the pixels of camera ``index``, computed only from the other views.

        Pixels outside the visual hull of the other views have the value NO_CELL_LOG_ODDS.
        """
        return self.grid.max_projection(self.alive, self.leave_one_out[index], index)

    def box(self) -> tuple[Array, Array] | None:
        """Return the corners of the bounding box of all voxels with positive scores, or None if no score is
        positive."""
        centres = self.grid.xyz[self.alive[self.total > 0]]
        if not len(centres):
            return None
        margin = 1.5 * self.grid.size
        return centres.min(axis=0) - margin, centres.max(axis=0) + margin


def dilate(picture: Floats, width: int) -> Floats:
    """Apply a maximum filter over squares with a side of ``width`` pixels.

    ``width`` is the width of a voxel's projection. The maximum is used because a voxel counts as occupied if the
    subject is anywhere in the voxel's projection.
    """
    return picture if width <= 1 else np.asarray(cv2.dilate(picture, _square(width)), np.float32)


def _square(width: int) -> Picture:
    return np.ones((width, width), np.uint8)


Picture = NDArray[np.uint8]
