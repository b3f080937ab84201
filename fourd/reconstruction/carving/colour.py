"""Colours of surface points, averaged over the views that see each point."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.reconstruction.carving.silhouette import Floats, sample

DEPTH_CELL = 2.5
"""Side length of a cell of the coarse depth map, as a multiple of the point spacing. It is so large that the nearest
surface has at least one point in each cell that it covers."""


def colour_points(
    xyz: Floats,
    normals: Floats,
    spacing: float,
    images: Sequence[NDArray[np.uint8]],
    cameras: Sequence[Camera],
) -> NDArray[np.uint8]:
    """Colour each point with the weighted mean of the colours that the views see at the point.

    A view sees a point if the point faces the camera and is not occluded. A point is occluded if it lies more than a
    few point spacings behind the nearest point in the same cell of a coarse depth map. The weight of a view is the
    fourth power of the cosine of the angle between the normal and the direction to the camera, so it is small at
    silhouette edges, where pixels mix with the background.

    Args:
        xyz: (N, 3) world points.
        normals: (N, 3) outward unit normals.
        spacing: distance between neighbouring points in world units.
        images: RGB images (H, W, 3) uint8, one per camera.
        cameras: undistorted pinhole cameras.

    Returns:
        (N, 3) uint8 RGB colours.
    """
    total = np.zeros((len(xyz), 3), dtype=np.float32)
    weights = np.full((len(xyz), 1), 1e-12, dtype=np.float32)
    for image, camera in zip(images, cameras, strict=True):
        x, y, depth = _project(xyz, camera)
        cosine = _view_cosine(xyz, normals, camera)
        inside = (depth > 0) & (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)
        seen = np.flatnonzero(inside)
        visible = _is_unoccluded(x[seen], y[seen], depth[seen], camera, spacing)
        weight = np.float32(1e-6) + visible * np.maximum(cosine[seen], 0) ** 4
        values = sample(image, x[seen], y[seen], cv2.INTER_LINEAR).astype(np.float32)
        total[seen] += weight[:, None] * values
        weights[seen, 0] += weight
    return np.rint(total / weights).clip(0, 255).astype(np.uint8)


def _project(xyz: Floats, camera: Camera) -> tuple[Floats, Floats, Floats]:
    """Return the pixel coordinates x (N,) and y (N,) and depths (N,) of world points (N, 3), all in float32."""
    matrix = camera.intrinsics @ camera.rotation
    offset = camera.intrinsics @ camera.translation
    x, y, depth = matrix.astype(np.float32) @ xyz.T + offset.astype(np.float32)[:, None]
    inverse = 1 / np.where(depth > 0, depth, np.float32(1))
    return x * inverse, y * inverse, depth


def _view_cosine(xyz: Floats, normals: Floats, camera: Camera) -> Floats:
    """Return the cosine (N,) of the angle between the outward normal of each point and the direction to the camera."""
    rays = camera.centre.astype(np.float32) - xyz
    return (rays * normals).sum(axis=1) / np.maximum(np.sqrt((rays**2).sum(axis=1)), np.float32(1e-12))


def _is_unoccluded(x: Floats, y: Floats, depth: Floats, camera: Camera, spacing: float) -> NDArray[np.bool_]:
    """Return a bool array (N,) that is True for points that lie at most three cell widths behind the nearest point in
    the same cell of the depth map."""
    if depth.size == 0:
        return np.zeros(0, dtype=np.bool_)
    focal = float(np.sqrt(camera.intrinsics[0, 0] * camera.intrinsics[1, 1]))
    cell = max(1.0, DEPTH_CELL * spacing * focal / float(np.median(depth)))
    columns = int(camera.width / cell) + 1
    key = (y / cell).astype(np.int64) * columns + (x / cell).astype(np.int64)
    front = np.full((int(camera.height / cell) + 1) * columns, np.inf, dtype=np.float32)
    np.minimum.at(front, key, depth)
    return depth <= front[key] + np.float32(3 * DEPTH_CELL * spacing)
