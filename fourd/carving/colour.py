"""Colours of surface points from the views that see them."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera
from fourd.carving.silhouette import Floats, sample

DEPTH_CELL = 2.5
"""Side of a depth-map cell in point spacings: wide enough that the nearest surface leaves no holes."""


def colour_points(
    xyz: Floats,
    normals: Floats,
    spacing: float,
    images: Sequence[NDArray[np.uint8]],
    cameras: Sequence[Camera],
) -> NDArray[np.uint8]:
    """Colours (N, 3) uint8 of points (N, 3): the mean over the views that see them, frontal views first.

    A view sees a point when the point faces it and lies no more than a few point
    spacings behind the nearest point there. Weights are the fourth power of the cosine,
    so that rims, which touch the background, count for little.

    Args:
        normals: (N, 3) outward unit normals.
        spacing: distance between neighbouring points, world units.
        images: RGB uint8 (H, W, 3), one per camera.
    """
    total = np.zeros((len(xyz), 3), dtype=np.float32)
    weights = np.full((len(xyz), 1), 1e-12, dtype=np.float32)
    for image, camera in zip(images, cameras, strict=True):
        x, y, depth = _projected(xyz, camera)
        cosine = _facing(xyz, normals, camera)
        inside = (depth > 0) & (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)
        seen = np.flatnonzero(inside)
        visible = _nearest(x[seen], y[seen], depth[seen], camera, spacing)
        weight = np.float32(1e-6) + visible * np.maximum(cosine[seen], 0) ** 4
        values = sample(image, x[seen], y[seen], cv2.INTER_LINEAR).astype(np.float32)
        total[seen] += weight[:, None] * values
        weights[seen, 0] += weight
    return np.rint(total / weights).clip(0, 255).astype(np.uint8)


def _projected(xyz: Floats, camera: Camera) -> tuple[Floats, Floats, Floats]:
    matrix = camera.intrinsics @ camera.rotation
    offset = camera.intrinsics @ camera.translation
    x, y, depth = matrix.astype(np.float32) @ xyz.T + offset.astype(np.float32)[:, None]
    inverse = 1 / np.where(depth > 0, depth, np.float32(1))
    return x * inverse, y * inverse, depth


def _facing(xyz: Floats, normals: Floats, camera: Camera) -> Floats:
    """Cosine (N,) between the outward normal and the direction to the camera."""
    rays = camera.centre.astype(np.float32) - xyz
    return (rays * normals).sum(axis=1) / np.maximum(np.sqrt((rays**2).sum(axis=1)), np.float32(1e-12))


def _nearest(x: Floats, y: Floats, depth: Floats, camera: Camera, spacing: float) -> NDArray[np.bool_]:
    """Which points are the nearest in their depth-map cell, up to the cell's own width of slope."""
    if depth.size == 0:
        return np.zeros(0, dtype=np.bool_)
    focal = float(np.sqrt(camera.intrinsics[0, 0] * camera.intrinsics[1, 1]))
    cell = max(1.0, DEPTH_CELL * spacing * focal / float(np.median(depth)))
    columns = int(camera.width / cell) + 1
    key = (y / cell).astype(np.int64) * columns + (x / cell).astype(np.int64)
    front = np.full((int(camera.height / cell) + 1) * columns, np.inf, dtype=np.float32)
    np.minimum.at(front, key, depth)
    return depth <= front[key] + np.float32(3 * DEPTH_CELL * spacing)
