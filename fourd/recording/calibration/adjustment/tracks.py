"""Feature tracks across cameras, and triangulation of one point per track."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fourd.base.cameras import Camera
from fourd.recording.stereo.features import Features, fundamental_matrix

Array = NDArray[np.float64]
Index = NDArray[np.intp]
Pair = tuple[int, int]

MIN_ANGLE_DEG = 2.0
MIN_DETERMINANT = 1e-8
"""Minimum determinant of the sum of a track's projectors, if the track determines a point."""


@dataclass(frozen=True, eq=False)
class Observations:
    """M observed features of P points.

    Attributes:
        camera: (M,) index of the camera of each feature.
        point: (M,) index of the point of each feature.
        pixel: (M, 2) position of each feature in pixels.
    """

    camera: Index
    point: Index
    pixel: Array

    @property
    def points(self) -> int:
        """Number P of points. Each point, from index 0 to P - 1, has at least one feature."""
        return int(self.point.max()) + 1 if len(self.point) else 0

    def of_points(self, kept: NDArray[np.bool_]) -> Observations:
        """Select the features of the points for which the mask ``kept`` (P,) is true, and renumber these points."""
        rows = kept[self.point]
        return Observations(self.camera[rows], (np.cumsum(kept) - 1)[self.point[rows]], self.pixel[rows])

    def select(self, rows: NDArray[np.bool_]) -> Observations:
        """Select the features for which the mask ``rows`` (M,) is true. Then drop points with fewer than two features,
        and renumber the other points."""
        camera, point, pixel = self.camera[rows], self.point[rows], self.pixel[rows]
        enough = np.bincount(point, minlength=self.points) >= 2
        return Observations(camera, point, pixel).of_points(enough)


@dataclass(frozen=True, eq=False)
class FrameMatches:
    """Features and matches of one frame.

    Attributes:
        features: the features of each camera.
        matches: for each pair of cameras, the indices (M, 2) of M pairs of matching features.
    """

    features: tuple[Features, ...]
    matches: dict[Pair, Index]


def build_tracks(frames: Sequence[FrameMatches], cameras: Sequence[Camera], band_px: float) -> Observations:
    """Build feature tracks across cameras from matches. Matches farther than ``band_px`` from their epipolar lines are
    ignored.

    If a track has several features in the same camera, these features are dropped.
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
    """Build the tracks of one frame: the connected components of the graph of matches."""
    features = frame.features
    counts = [len(each.xy_px) for each in features]
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
    ends = [np.zeros((0, 2), np.intp)]
    for (i, j), rows in frame.matches.items():
        first_xy, second_xy = features[i].xy_px[rows[:, 0]], features[j].xy_px[rows[:, 1]]
        near = _epipolar_distances(first_xy, second_xy, cameras[i], cameras[j]) < band_px
        ends.append(rows[near] + (offsets[i], offsets[j]))
    edges = np.concatenate(ends)
    total = int(offsets[-1])
    graph = coo_array((np.ones(len(edges), bool), (edges[:, 0], edges[:, 1])), shape=(total, total))
    _, label = connected_components(graph, directed=False)
    camera = np.repeat(np.arange(len(features)), counts)
    # A wrong match merges the tracks of two points. In each camera that sees both points, the merged track has two
    # features, which are dropped.
    _, inverse, occurrences = np.unique(label * len(features) + camera, return_inverse=True, return_counts=True)
    xy = np.concatenate([each.xy_px for each in features])
    return Observations(camera, label.astype(np.intp), xy).select(occurrences[inverse] == 1)


def _epipolar_distances(first_xy: Array, second_xy: Array, camera: Camera, other: Camera) -> Array:
    """Return the distance (M,), in pixels, of each match from its epipolar lines: the larger of the distances in the
    two images."""
    first, second = (np.column_stack([xy, np.ones(len(xy))]) for xy in (first_xy, second_xy))
    matrix = fundamental_matrix(camera, other)
    second_lines, first_lines = first @ matrix.T, second @ matrix
    algebraic = np.abs((second_lines * second).sum(axis=1))
    lengths = (np.hypot(lines[:, 0], lines[:, 1]) for lines in (second_lines, first_lines))
    return algebraic / np.maximum(np.minimum(*lengths), 1e-12)


def triangulate_points(tracks: Observations, cameras: Sequence[Camera]) -> tuple[Array, NDArray[np.bool_]]:
    """Triangulate one point per track: the point with the smallest sum of squared distances to the track's rays.

    Returns:
        world points (P, 3), and a mask (P,) that is true for points whose rays span an angle of at least about 2
        degrees. If the rays span less than about 2 degrees, the position of the point is undefined.
    """
    origins = np.stack([camera.centre for camera in cameras])[tracks.camera]
    rays = _ray_directions(tracks, cameras)
    projectors = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    normal, right = np.zeros((tracks.points, 3, 3)), np.zeros((tracks.points, 3))
    np.add.at(normal, tracks.point, projectors)
    np.add.at(right, tracks.point, np.einsum("mij,mj->mi", projectors, origins))
    sums = np.zeros((tracks.points, 3))
    np.add.at(sums, tracks.point, rays)
    # The unit vectors along a track's rays are averaged. The larger the angle that the rays span, the shorter the mean
    # vector. For two rays, its length is cos(angle / 2).
    count = np.bincount(tracks.point, minlength=tracks.points)
    mean_length = np.linalg.norm(sums, axis=1) / np.maximum(count, 1)
    is_wide = mean_length < np.cos(np.radians(MIN_ANGLE_DEG) / 2)
    # The rays of two cameras that face each other span 180 degrees, and do not determine the point either.
    is_wide &= np.linalg.det(normal) > MIN_DETERMINANT
    normal[~is_wide] = np.eye(3)
    return np.asarray(np.linalg.solve(normal, right[..., None])[..., 0], np.float64), np.asarray(is_wide)


def _ray_directions(tracks: Observations, cameras: Sequence[Camera]) -> Array:
    """Return the unit vectors (M, 3) in world coordinates along the viewing rays of the features."""
    R_world_pixel = np.stack([camera.rotation.T @ np.linalg.inv(camera.intrinsics) for camera in cameras])
    pixels = np.column_stack([tracks.pixel, np.ones(len(tracks.pixel))])
    rays = np.einsum("mij,mj->mi", R_world_pixel[tracks.camera], pixels)
    return rays / np.linalg.norm(rays, axis=1, keepdims=True)
