"""Fill holes: places of a plate at which no background point is rendered, although the plate shows a surface there.

Such places have no depth, because no other plate shows the same surface, or only at a grazing angle. A view would be
black there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from fourd.base.cameras import Camera
from fourd.base.formats.ply import ColouredPoints
from fourd.base.progress import Track, untracked
from fourd.reconstruction.background.plates import PlateView
from fourd.reconstruction.background.shell import occludes
from fourd.rendering.ops.neighbours import nearest_neighbours
from fourd.rendering.ops.points.arrays import render_points_numpy

MAX_SIDE_PX = 320
"""Maximum length of the longer side of the images in which holes are found."""
RADIUS_SPACINGS = 1.3
NEIGHBOURS = 4
LAYERS = 16
MIN_ALPHA = 0.5
GAP_PX = 3
"""Gaps between neighbouring discs that are at most this wide are no holes, because training closes them by larger
discs."""
STRIDE_PX = 2
SMOOTHING_PX = 3.0


@dataclass(frozen=True, eq=False)
class Coverage:
    """Fractions in [0, 1] of the area of each plate that background points cover, by camera name."""

    shares: dict[str, float]

    @property
    def mean(self) -> float:
        return float(np.mean(list(self.shares.values())))

    @property
    def least(self) -> float:
        return min(self.shares.values())

    def __str__(self) -> str:
        least = min(self.shares, key=lambda name: self.shares[name])
        return f"{self.mean:.1%} of the plates' area (least: camera '{least}', {self.shares[least]:.1%})"


def measure_coverage(points: ColouredPoints, plates: Sequence[PlateView], near: float) -> Coverage:
    """Measure how large a fraction of each plate the points cover. ``near`` is the depth of the near plane."""
    radius = _radii(points)
    shares = {}
    for plate in plates:
        camera, _, seen = _reduce(plate)
        hole = _find_holes(points, radius, camera, seen, near)[0]
        shares[plate.name] = 1 - float(hole.sum()) / max(1, int(seen.sum()))
    return Coverage(shares)


def fill_holes(
    points: ColouredPoints, plates: Sequence[PlateView], near: float, track: Track = untracked
) -> ColouredPoints:
    """Create points that fill the holes of all plates. Returns only the new points.

    The inverse depth in a hole is that of the nearest rendered pixel, smoothed. The colours are those of the plate.
    New points that would occlude other points in a plate are dropped.
    """
    radius = _radii(points)
    xyz, colours = [np.zeros((0, 3))], [np.zeros((0, 3), np.uint8)]
    for _, plate in track(enumerate(plates), len(plates), "background: holes"):
        camera, rgb, seen = _reduce(plate)
        hole, inverse = _find_holes(points, radius, camera, seen, near)
        if not hole.any() or not (inverse > 0).any():
            continue
        whole = _continue(inverse)
        is_chosen = np.add.outer(np.arange(hole.shape[0]), np.arange(hole.shape[1])) % STRIDE_PX == 0
        rows, columns = np.nonzero(hole & is_chosen & (whole > 0))
        xyz.append(camera.unproject(np.column_stack([columns, rows]) + 0.5, 1 / whole[rows, columns].astype(float)))
        colours.append(rgb[rows, columns])
    found, chosen = np.concatenate(xyz), np.concatenate(colours)
    if not len(found):
        return ColouredPoints(found.astype(np.float32), chosen)
    kept = ~occludes(found, points.xyz.astype(np.float64), [plate.camera for plate in plates])
    return ColouredPoints(found[kept].astype(np.float32), chosen[kept])


def _continue(inverse: NDArray[np.float32]) -> NDArray[np.float32]:
    """Continue inverse depths (H, W) into the pixels at which they are 0."""
    unknown = inverse <= 0
    row, column = distance_transform_edt(unknown, return_distances=False, return_indices=True)
    nearest = inverse[row, column]
    return np.asarray(np.where(unknown, cv2.GaussianBlur(nearest, (0, 0), SMOOTHING_PX), nearest), np.float32)


def _reduce(plate: PlateView) -> tuple[Camera, NDArray[np.uint8], NDArray[np.bool_]]:
    """Reduce a plate to the size in which holes are found. Returns its camera, colours and visible pixels."""
    camera = plate.camera.rescale(min(1.0, MAX_SIDE_PX / max(plate.camera.width, plate.camera.height)))
    size = (camera.width, camera.height)
    rgb = np.asarray(cv2.resize(plate.rgb, size, interpolation=cv2.INTER_AREA), np.uint8)
    seen = cv2.resize(plate.seen.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return camera, rgb, np.asarray(seen > 0.999)


def _radii(points: ColouredPoints) -> NDArray[np.float32]:
    """Return the radii (N,) of discs that overlap their neighbours' discs."""
    distance = nearest_neighbours(points.xyz, points.xyz, min(NEIGHBOURS + 1, len(points.xyz)))[0]
    return np.asarray(RADIUS_SPACINGS * distance[:, 1:].mean(axis=1), np.float32)


def _find_holes(
    points: ColouredPoints, radius: NDArray[np.float32], camera: Camera, seen: NDArray[np.bool_], near: float
) -> tuple[NDArray[np.bool_], NDArray[np.float32]]:
    """Return a mask (H, W) of the holes, and the inverse depth (H, W), which is 0 where no point is rendered."""
    ones = np.ones((len(radius), 1), np.float32)
    density = np.full(len(radius), 0.99, np.float32)
    _, alpha, depth = render_points_numpy(points.xyz, ones, radius, density, camera, layers=LAYERS, near=near)
    closed = cv2.morphologyEx(
        (alpha > MIN_ALPHA).astype(np.uint8), cv2.MORPH_CLOSE, np.ones((GAP_PX, GAP_PX), np.uint8)
    )
    inverse = np.where(alpha > MIN_ALPHA, 1 / np.maximum(depth, 1e-9), 0)
    return np.asarray((closed == 0) & seen), np.asarray(inverse, np.float32)
