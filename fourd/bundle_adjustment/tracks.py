"""Places that several cameras' features show, and where they lie as the cameras stand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fourd.background.stereo.features import Features, fundamental_matrix
from fourd.cameras import Camera

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Pair = tuple[int, int]

LEAST_ANGLE_DEG = 2.0


@dataclass(frozen=True, eq=False)
class Observations:
    """M features of points: which camera's (M,), which point's (M,), and where, in pixels (M, 2)."""

    camera: Index
    point: Index
    pixel: Array

    @property
    def points(self) -> int:
        """Number of points, which are numbered from 0 without gaps."""
        return int(self.point.max()) + 1 if len(self.point) else 0

    def of_points(self, kept: NDArray[np.bool_]) -> Observations:
        """Those of some of the points (P,), numbered anew."""
        rows = kept[self.point]
        return Observations(self.camera[rows], (np.cumsum(kept) - 1)[self.point[rows]], self.pixel[rows])

    def only(self, rows: NDArray[np.bool_]) -> Observations:
        """Some of the features (M,), of the points that keep two or more."""
        camera, point, pixel = self.camera[rows], self.point[rows], self.pixel[rows]
        enough = np.bincount(point, minlength=self.points) >= 2
        return Observations(camera, point, pixel).of_points(enough)


@dataclass(frozen=True, eq=False)
class Moment:
    """What the cameras saw at one moment: each camera's features, and by pair of cameras those alike (M, 2)."""

    features: tuple[Features, ...]
    matches: dict[Pair, Index]


def observations(moments: Sequence[Moment], cameras: Sequence[Camera], band_px: float) -> Observations:
    """Features that are alike and within ``band_px`` of their epipolar lines, joined over the pairs.

    A point that has two features in one camera has none of them.
    """
    parts, points = [], 0
    for moment in moments:
        found = _joined(moment, cameras, band_px)
        parts.append(Observations(found.camera, found.point + points, found.pixel))
        points += found.points
    return Observations(
        np.concatenate([part.camera for part in parts]),
        np.concatenate([part.point for part in parts]),
        np.concatenate([part.pixel for part in parts]),
    )


def _joined(moment: Moment, cameras: Sequence[Camera], band_px: float) -> Observations:
    features = moment.features
    counts = [len(each.xy) for each in features]
    first = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
    ends = [np.zeros((0, 2), np.intp)]
    for (i, j), rows in moment.matches.items():
        here, there = features[i].xy[rows[:, 0]], features[j].xy[rows[:, 1]]
        near = _line_distances(here, there, cameras[i], cameras[j]) < band_px
        ends.append(rows[near] + (first[i], first[j]))
    edges = np.concatenate(ends)
    total = int(first[-1])
    graph = coo_array((np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), shape=(total, total))
    _, label = connected_components(graph, directed=False)
    camera = np.repeat(np.arange(len(features)), counts)
    # A wrong match ties two places together: their features in the cameras that see both say nothing.
    _, place, times = np.unique(label * len(features) + camera, return_inverse=True, return_counts=True)
    xy = np.concatenate([each.xy for each in features])
    return Observations(camera, label.astype(np.intp), xy).only(times[place] == 1)


def _line_distances(here: Array, there: Array, camera: Camera, other: Camera) -> Array:
    """(M,) greater distance of two places (M, 2) from each other's epipolar lines, in pixels."""
    first, second = (np.column_stack([xy, np.ones(len(xy))]) for xy in (here, there))
    matrix = fundamental_matrix(camera, other)
    lines_there, lines_here = first @ matrix.T, second @ matrix
    off = np.abs((lines_there * second).sum(axis=1))
    lengths = (np.hypot(lines[:, 0], lines[:, 1]) for lines in (lines_there, lines_here))
    return off / np.maximum(np.minimum(*lengths), 1e-12)


def placed_points(found: Observations, cameras: Sequence[Camera]) -> tuple[Array, NDArray[np.bool_]]:
    """Where each point (P, 3) is nearest to its rays, and (P,) whether two of these are 2 degrees apart or more."""
    origins = np.stack([camera.centre for camera in cameras])[found.camera]
    rays = _rays(found, cameras)
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    normal, right = np.zeros((found.points, 3, 3)), np.zeros((found.points, 3))
    np.add.at(normal, found.point, across)
    np.add.at(right, found.point, np.einsum("mij,mj->mi", across, origins))
    sums = np.zeros((found.points, 3))
    np.add.at(sums, found.point, rays)
    # The mean of unit rays is as short as they are apart: for two of them half of cos(angle / 2).
    count = np.bincount(found.point, minlength=found.points)
    spread = np.linalg.norm(sums, axis=1) / np.maximum(count, 1)
    apart = spread < np.cos(np.radians(LEAST_ANGLE_DEG) / 2)
    normal[~apart] = np.eye(3)
    return np.asarray(np.linalg.solve(normal, right[..., None])[..., 0], np.float64), np.asarray(apart)


def _rays(found: Observations, cameras: Sequence[Camera]) -> Array:
    """(M, 3) unit directions of the features in the world."""
    turned = np.stack([camera.rotation.T @ np.linalg.inv(camera.intrinsics) for camera in cameras])
    rays = np.einsum("mij,mj->mi", turned[found.camera], np.column_stack([found.pixel, np.ones(len(found.pixel))]))
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)
