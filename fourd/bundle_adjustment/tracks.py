"""Feature tracks across cameras, and their triangulation."""

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

MIN_ANGLE_DEG = 2.0


@dataclass(frozen=True, eq=False)
class Observations:
    """M observed features of P points.

    Attributes:
        camera: (M,) index of the camera.
        point: (M,) index of the point.
        pixel: (M, 2) position, pixels.
    """

    camera: Index
    point: Index
    pixel: Array

    @property
    def points(self) -> int:
        """Number of points; their indices are 0 to P - 1 without gaps."""
        return int(self.point.max()) + 1 if len(self.point) else 0

    def of_points(self, kept: NDArray[np.bool_]) -> Observations:
        """The features of the points selected by ``kept`` (P,) bool; points are renumbered."""
        rows = kept[self.point]
        return Observations(self.camera[rows], (np.cumsum(kept) - 1)[self.point[rows]], self.pixel[rows])

    def select(self, rows: NDArray[np.bool_]) -> Observations:
        """The features selected by ``rows`` (M,) bool; points with fewer than two features are dropped."""
        camera, point, pixel = self.camera[rows], self.point[rows], self.pixel[rows]
        enough = np.bincount(point, minlength=self.points) >= 2
        return Observations(camera, point, pixel).of_points(enough)


@dataclass(frozen=True, eq=False)
class FrameMatches:
    """Features and matches of one frame.

    Attributes:
        features: of each camera.
        matches: (M, 2) feature indices per pair of cameras.
    """

    features: tuple[Features, ...]
    matches: dict[Pair, Index]


def build_tracks(frames: Sequence[FrameMatches], cameras: Sequence[Camera], band_px: float) -> Observations:
    """Connect matches within ``band_px`` of their epipolar lines into tracks across cameras.

    Where a track has several features in one camera, these features are dropped.
    """
    parts, points = [], 0
    for frame in frames:
        tracks = _frame_tracks(frame, cameras, band_px)
        parts.append(Observations(tracks.camera, tracks.point + points, tracks.pixel))
        points += tracks.points
    return Observations(
        np.concatenate([part.camera for part in parts]),
        np.concatenate([part.point for part in parts]),
        np.concatenate([part.pixel for part in parts]),
    )


def _frame_tracks(frame: FrameMatches, cameras: Sequence[Camera], band_px: float) -> Observations:
    """The tracks of one frame: connected components of the graph of matches."""
    features = frame.features
    counts = [len(each.xy) for each in features]
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
    ends = [np.zeros((0, 2), np.intp)]
    for (i, j), rows in frame.matches.items():
        first_xy, second_xy = features[i].xy[rows[:, 0]], features[j].xy[rows[:, 1]]
        near = _epipolar_distances(first_xy, second_xy, cameras[i], cameras[j]) < band_px
        ends.append(rows[near] + (offsets[i], offsets[j]))
    edges = np.concatenate(ends)
    total = int(offsets[-1])
    graph = coo_array((np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), shape=(total, total))
    _, label = connected_components(graph, directed=False)
    camera = np.repeat(np.arange(len(features)), counts)
    # A wrong match merges two points into one track: cameras that see both have two features in it.
    _, entry, times = np.unique(label * len(features) + camera, return_inverse=True, return_counts=True)
    xy = np.concatenate([each.xy for each in features])
    return Observations(camera, label.astype(np.intp), xy).select(times[entry] == 1)


def _epipolar_distances(first_xy: Array, second_xy: Array, camera: Camera, other: Camera) -> Array:
    """(M,) larger distance of two matched features (M, 2) from each other's epipolar lines, pixels."""
    first, second = (np.column_stack([xy, np.ones(len(xy))]) for xy in (first_xy, second_xy))
    matrix = fundamental_matrix(camera, other)
    second_lines, first_lines = first @ matrix.T, second @ matrix
    algebraic = np.abs((second_lines * second).sum(axis=1))
    lengths = (np.hypot(lines[:, 0], lines[:, 1]) for lines in (second_lines, first_lines))
    return algebraic / np.maximum(np.minimum(*lengths), 1e-12)


def triangulate_points(tracks: Observations, cameras: Sequence[Camera]) -> tuple[Array, NDArray[np.bool_]]:
    """Triangulate each track linearly, as the point nearest to its rays.

    Returns:
        points (P, 3), world units, and (P,) bool: whether the rays of the point span about 2 degrees or more.
        Points with smaller angles have no defined position.
    """
    origins = np.stack([camera.centre for camera in cameras])[tracks.camera]
    rays = _ray_directions(tracks, cameras)
    projectors = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    normal, right = np.zeros((tracks.points, 3, 3)), np.zeros((tracks.points, 3))
    np.add.at(normal, tracks.point, projectors)
    np.add.at(right, tracks.point, np.einsum("mij,mj->mi", projectors, origins))
    sums = np.zeros((tracks.points, 3))
    np.add.at(sums, tracks.point, rays)
    # The mean of unit rays is shorter the wider their angle: cos(angle / 2) for two of them.
    count = np.bincount(tracks.point, minlength=tracks.points)
    mean_length = np.linalg.norm(sums, axis=1) / np.maximum(count, 1)
    is_wide = mean_length < np.cos(np.radians(MIN_ANGLE_DEG) / 2)
    normal[~is_wide] = np.eye(3)
    return np.asarray(np.linalg.solve(normal, right[..., None])[..., 0], np.float64), np.asarray(is_wide)


def _ray_directions(tracks: Observations, cameras: Sequence[Camera]) -> Array:
    """(M, 3) unit directions of the features' rays in the world."""
    R_world_pixel = np.stack([camera.rotation.T @ np.linalg.inv(camera.intrinsics) for camera in cameras])
    pixels = np.column_stack([tracks.pixel, np.ones(len(tracks.pixel))])
    rays = np.einsum("mij,mj->mi", R_world_pixel[tracks.camera], pixels)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)
