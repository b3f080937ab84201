"""Select the source cameras that see the space in front of a reference camera at suitable triangulation angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera

Array = NDArray[np.float64]

MAX_SOURCES = 6
RAYS = 12
DEPTHS = 8
BEST_ANGLE_DEG = 15.0
ANGLE_SPREAD = 0.9
"""Half width at half maximum of a source camera's score, which is a bell-shaped function of ln(angle). The angle is
measured at a point, between the rays to the source camera and to the reference camera. The score is 1 at 15 degrees,
and 1/2 at 6 and at 37 degrees. It is 1/7 at 130 degrees, an angle between two cameras that see a floor from opposite
sides, for example."""
MIN_GAIN = 0.01
"""The selection ends when no camera increases the objective, which :func:`select_sources` defines, by at least this
value per sampled point."""


def select_sources(cameras: Sequence[Camera], index: int, nearest: float, farthest: float) -> list[int]:
    """Select up to 6 source cameras for the reference camera ``index`` such that, if possible, at least two of them see
    each point in the frustum of the reference camera.

    Points are sampled in the frustum between the depths ``nearest`` and ``farthest``. A source camera's score for a
    point depends on the triangulation angle with the reference camera. The objective is the sum of each sampled point's
    two best scores. The selection is greedy: each step adds the camera that increases the objective most.
    """
    xyz = _frustum_points(cameras[index], nearest, farthest)
    scores = np.array([_view_scores(cameras[index], other, xyz) for other in cameras])
    scores[index] = 0
    chosen: list[int] = []
    best = np.zeros((2, len(xyz)))
    while len(chosen) < MAX_SOURCES:
        before = np.broadcast_to(best, (len(cameras), *best.shape))
        with_each = np.sort(np.concatenate([before, scores[:, None]], axis=1), axis=1)[:, 1:]
        gains = with_each.sum(axis=(1, 2)) - best.sum()
        gains[chosen] = 0
        winner = int(gains.argmax())
        if gains[winner] < MIN_GAIN * len(xyz):
            break
        chosen.append(winner)
        best = with_each[winner]
    return chosen


def _frustum_points(camera: Camera, nearest: float, farthest: float) -> Array:
    """Sample world points (N, 3) in the camera's frustum, on a grid over the image and at uniform steps of inverse
    depth."""
    middles = (np.arange(RAYS) + 0.5) / RAYS
    x, y = np.meshgrid(middles * camera.width, middles * camera.height)
    pixels = np.column_stack([x.ravel(), y.ravel()])
    depths = 1 / np.linspace(1 / farthest, 1 / nearest, DEPTHS)
    return camera.unproject(np.tile(pixels, (DEPTHS, 1)), np.repeat(depths, len(pixels)))


def _view_scores(camera: Camera, other: Camera, xyz: Array) -> Array:
    """Compute the scores (N,) in [0, 1] of the source camera ``other`` for points. The score is 0 for points outside
    its image."""
    pixels, depth = other.project(xyz)
    seen = other.is_in_image(pixels, depth)
    cosine = np.einsum("nc,nc->n", _directions(camera, xyz), _directions(other, xyz))
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return seen / (1 + (np.log(np.maximum(angle, 0.01) / BEST_ANGLE_DEG) / ANGLE_SPREAD) ** 2)


def _directions(camera: Camera, xyz: Array) -> Array:
    rays = camera.centre - xyz
    return np.asarray(rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12), np.float64)
