"""Which points inside a room belong to the subject: those connected with something that moves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from fourd.base.cameras import Array, Camera
from fourd.recording.capture.focus import find_focus, median_distance
from fourd.recording.matting.solid.room import Room

Flags = NDArray[np.bool_]

MAX_DEPTH_SHARE = 0.85
"""Points within this fraction of the room's distance are inside the room. The rest of the room's depth is left to
whatever stands at the walls, and to errors of stereo."""
VOXEL_SHARE = 0.03
"""Side of a voxel, as a fraction of the median distance of the cameras from the centre: 8 cm at 2.7 m. Parts of a body
between which stereo found nothing, such as a plain shirt, are connected if the gap is below three voxels."""
MIN_POINTS = 2
"""Minimum number of points in an occupied voxel. Single points are mostly errors."""
MIN_COMPONENT = 100
"""Minimum number of points of an object."""
MOVING_VIEWS = 0.9
"""A point moves if it lies in the moving region of at least this fraction of the cameras that see its place."""
MIN_MOVING = 0.05
"""An object belongs to the subject if at least this fraction of its points moves."""


def find_subject_points(moments: Sequence[Array], cameras: Sequence[Camera], regions: Sequence[Flags]) -> list[Array]:
    """Find the points of the subject at each moment.

    Whoever stands still is found because a part of him moves: a head, a hand. Tables and lamps are inside the room too,
    but they do not move, unless somebody stands between them and most cameras.

    Args:
        moments: points (N, 3) on all surfaces at each moment, in world units.
        cameras: the cameras of ``regions``.
        regions: (h, w) bool for each camera, true where something moves at any time of the recording.

    Returns:
        one array (M, 3) for each moment; empty arrays if the cameras have no common focus.
    """
    centre = find_focus(list(cameras)) if len(cameras) > 1 else None
    everything = np.concatenate([np.zeros((0, 3)), *moments])
    if centre is None or not len(everything):
        return [np.zeros((0, 3)) for _ in moments]
    room = Room.around(centre, everything, cameras)
    voxel = VOXEL_SHARE * reach(cameras)
    inside = [xyz[room.depth_share(xyz) < MAX_DEPTH_SHARE] for xyz in moments]
    return [_moving_objects(xyz, voxel, cameras, regions) for xyz in inside]


def reach(cameras: Sequence[Camera]) -> float:
    """Return the median distance of the cameras from their focus in world units. The cameras must have a focus."""
    focus = find_focus(list(cameras))
    if focus is None:
        raise ValueError("expected cameras with a common focus, got parallel cameras")
    return median_distance(cameras, focus)


def _moving_objects(xyz: Array, voxel: float, cameras: Sequence[Camera], regions: Sequence[Flags]) -> Array:
    """Return the points (M, 3) of those objects among ``xyz`` (N, 3) of which a part moves."""
    if not len(xyz):
        return xyz
    labels = _connected(xyz, voxel)
    moving = _moving_share(xyz, cameras, regions) >= MOVING_VIEWS
    counts = np.bincount(labels)
    moves = np.bincount(labels, weights=moving, minlength=len(counts)) >= MIN_MOVING * counts
    chosen = moves & (counts >= MIN_COMPONENT)
    chosen[0] = False
    return xyz[chosen[labels]]


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
