"""Which points inside a room belong to the subject: those connected with something that moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from fourd.base.cameras import Array, Camera
from fourd.recording.capture.focus import find_focus, median_distance
from fourd.recording.matting.solid.room import Room
from fourd.recording.stereo.plane_hypotheses import find_large_planes

Flags = NDArray[np.bool_]

MAX_DEPTH_SHARE = 0.85
"""Points within this fraction of the room's distance are inside the room. The rest of the room's depth is left to
whatever stands at the walls, and to errors of stereo."""
VOXEL_SHARE = 0.03
"""Side of a voxel, as a fraction of the median distance of the cameras from the centre: 8 cm at 2.7 m. Parts of a body
between which stereo found nothing, such as a plain shirt, are connected if the gap is below three voxels."""
PLANE_TOLERANCE = 0.01
"""Largest distance of a point from its plane, as a fraction of the median distance of the cameras from the centre."""
MIN_PLANE_SHARE = 0.02
"""A plane is the floor or a wall if at least this fraction of all points is on it."""
MAX_BEYOND = 0.03
"""Largest fraction of all points that may lie behind the floor or a wall: errors of stereo, and reflections."""
PLANE_POINTS = 20_000
"""Number of points among which planes are looked for."""
MIN_POINTS = 2
"""Minimum number of points in an occupied voxel. Single points are mostly errors."""
MIN_COMPONENT = 100
"""Minimum number of points of an object."""
MOVING_VIEWS = 0.9
"""A point moves if it lies in the moving region of at least this fraction of the cameras that see its place."""
MIN_MOVING = 0.02
"""An object belongs to the subject if at least this fraction of its points moves at one of the moments. Of a person who
stands still and catches a ball, 4 to 6% of the points move at some moments, and none at others."""
MAX_SHIFT = 2.1
"""Points rest if the same object is not farther away at the next moment, in voxels."""
SAME_PLACE = 0.5
"""Objects of two moments are the same, at rest, if their common voxels are at least this fraction of the larger one."""


@dataclass(frozen=True, eq=False)
class SubjectPoints:
    """Points on the subject in world units.

    Attributes:
        moments: one array (M, 3) for each moment.
        resting: one array (M, 3) for each moment but the last: those of its points whose object is at the same place at
            the next moment. They are on the subject at all times between these moments.
    """

    moments: tuple[Array, ...]
    resting: tuple[Array, ...]


def find_subject_points(moments: Sequence[Array], cameras: Sequence[Camera], regions: Sequence[Flags]) -> SubjectPoints:
    """Find the points of the subject at each moment.

    Whoever stands still is found because a part of him moves at one of the moments: a head, a hand. Tables and lamps
    are inside the room too, but they do not move, unless somebody stands between them and most cameras.

    Args:
        moments: points (N, 3) on all surfaces at each moment, in world units. The moments are in the order of time.
        cameras: the cameras of ``regions``.
        regions: (h, w) bool for each camera, true where something moves at any time of the recording.

    Returns:
        the points of the subject; empty arrays if the cameras have no common focus.
    """
    centre = find_focus(list(cameras)) if len(cameras) > 1 else None
    everything = np.concatenate([np.zeros((0, 3)), *moments])
    if centre is None or not len(everything):
        nothing = tuple(np.zeros((0, 3)) for _ in moments)
        return SubjectPoints(nothing, nothing[1:])
    room = Room.around(centre, everything, cameras)
    distance = reach(cameras)
    voxel, tolerance = VOXEL_SHARE * distance, PLANE_TOLERANCE * distance
    planes = _walls(everything, cameras, tolerance)
    inside = [
        xyz[(room.depth_share(xyz) < MAX_DEPTH_SHARE) & ~_is_on(planes, xyz, tolerance).any(axis=1)] for xyz in moments
    ]
    objects = [_Objects.find(xyz, voxel, cameras, regions) for xyz in inside]
    chosen = [each.subject(objects) for each in objects]
    return SubjectPoints(
        tuple(each.points(numbers) for each, numbers in zip(objects, chosen, strict=True)),
        tuple(each.resting(numbers, after) for each, after, numbers in zip(objects, objects[1:], chosen, strict=False)),
    )


def _walls(xyz: Array, cameras: Sequence[Camera], tolerance: float) -> Array:
    """Return the planes (P, 4), n . x = d, of the floor, the ceiling and flat walls.

    Where a subject stands on the floor, the distance of the room changes much within a cell of directions, so that
    points on the floor seem to be inside the room. All cameras are on one side of the floor, and nearly nothing is on
    the other side, unlike with a plane through a body.
    """
    rng = np.random.default_rng(0)
    some = xyz if len(xyz) <= PLANE_POINTS else xyz[rng.integers(0, len(xyz), PLANE_POINTS)]
    planes = find_large_planes(some, np.ones(len(some)), tolerance, rng)
    centres = np.stack([camera.centre for camera in cameras])
    sides = np.sign(centres @ planes[:, :3].T - planes[:, 3])
    offsets = (some @ planes[:, :3].T - planes[:, 3]) * sides[0]
    is_large = (np.abs(offsets) < tolerance).mean(axis=0) >= MIN_PLANE_SHARE
    is_outermost = (offsets < -2 * tolerance).mean(axis=0) <= MAX_BEYOND
    return planes[(sides == sides[0]).all(axis=0) & is_large & is_outermost]


def _is_on(planes: Array, xyz: Array, tolerance: float) -> NDArray[np.bool_]:
    """Return which of the points (N, 3) are on which of the P planes, as (N, P)."""
    return np.asarray(np.abs(xyz @ planes[:, :3].T - planes[:, 3]) < tolerance)


def reach(cameras: Sequence[Camera]) -> float:
    """Return the median distance of the cameras from their focus in world units. The cameras must have a focus."""
    focus = find_focus(list(cameras))
    if focus is None:
        raise ValueError("expected cameras with a common focus, got parallel cameras")
    return median_distance(cameras, focus)


@dataclass(frozen=True, eq=False)
class _Objects:
    """The connected objects at a moment.

    Attributes:
        xyz: (N, 3) points.
        cells: (N, 3) indices of the points' voxels.
        labels: (N,) number of the object of each point.
        moving: the share of the moving points of each object, by its number. Only objects of enough points are listed.
        places: the voxels of each object, by its number.
    """

    xyz: Array
    cells: NDArray[np.intp]
    labels: NDArray[np.intp]
    moving: dict[int, float]
    places: dict[int, frozenset[tuple[int, ...]]]

    @staticmethod
    def find(xyz: Array, voxel: float, cameras: Sequence[Camera], regions: Sequence[Flags]) -> _Objects:
        """Find the objects among the points ``xyz`` (N, 3)."""
        if not len(xyz):
            return _Objects(xyz, np.zeros((0, 3), np.intp), np.zeros(0, np.intp), {}, {})
        labels = _connected(xyz, voxel)
        moves = _moving_share(xyz, cameras, regions) >= MOVING_VIEWS
        chosen = [number for number in np.flatnonzero(np.bincount(labels) >= MIN_COMPONENT).tolist() if number]
        cells = np.floor(xyz / voxel).astype(np.intp)
        return _Objects(
            xyz,
            cells,
            labels,
            {number: float(moves[labels == number].mean()) for number in chosen},
            {number: frozenset(map(tuple, cells[labels == number].tolist())) for number in chosen},
        )

    def subject(self, moments: Sequence[_Objects]) -> list[int]:
        """Return the numbers of those objects that move at one of the moments."""
        return [
            number
            for number, share in self.moving.items()
            if max([share, *(each.moving[same] for each in moments for same in self._same(number, each))]) >= MIN_MOVING
        ]

    def points(self, numbers: Sequence[int]) -> Array:
        """Return the points (M, 3) of some of the objects."""
        return self.xyz[np.isin(self.labels, numbers)]

    def resting(self, numbers: Sequence[int], after: _Objects) -> Array:
        """Return those points (M, 3) of some of the objects that are at the same place at another moment, or at most
        :data:`MAX_SHIFT` from it: a head that turns stays."""
        kept = [np.zeros((0, 3))]
        for number in numbers:
            there = [cell for same in self._same(number, after) for cell in after.places[same]]
            if there:
                of_object = self.labels == number
                gaps = cKDTree(there).query(self.cells[of_object], distance_upper_bound=MAX_SHIFT)[0]
                kept.append(self.xyz[of_object][np.isfinite(gaps)])
        return np.concatenate(kept)

    def _same(self, number: int, moment: _Objects) -> list[int]:
        """Return the numbers of the objects of another moment that are at the place of an object."""
        place = self.places[number]
        return [
            other
            for other, where in moment.places.items()
            if len(place & where) >= SAME_PLACE * max(len(place), len(where))
        ]


def _connected(xyz: Array, voxel: float) -> NDArray[np.intp]:
    """Return the number (N,) of the object to which each point belongs, or 0 for a point without neighbours."""
    index = np.floor((xyz - xyz.min(axis=0)) / voxel).astype(np.intp) + 1
    counts = np.zeros(index.max(axis=0) + 2, np.intp)
    np.add.at(counts, tuple(index.T), 1)
    cube = np.ones((3, 3, 3), np.bool_)
    labels, _ = ndimage.label(ndimage.binary_dilation(counts >= MIN_POINTS, cube), cube)
    return np.asarray(labels[tuple(index.T)], np.intp)


def _moving_share(xyz: Array, cameras: Sequence[Camera], regions: Sequence[Flags]) -> Array:
    """Return, for each point, the fraction (N,) of the cameras that see its place in which it lies in the moving
    region."""
    seen, moving = np.zeros(len(xyz)), np.zeros(len(xyz))
    for camera, region in zip(cameras, regions, strict=True):
        pixels, depth = camera.project(xyz)
        inside = camera.is_in_image(pixels, depth)
        column, row = pixels[inside].astype(np.intp).T
        seen += inside
        moving[inside] += region[row, column]
    return np.asarray(moving / np.maximum(seen, 1), np.float64)
