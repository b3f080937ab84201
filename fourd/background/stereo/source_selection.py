"""Selection of source cameras for a reference camera. The source cameras must see the space in front of the reference
camera at suitable triangulation angles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera

Array = NDArray[np.float64]

MAX_SOURCES = 6
RAYS = 12
DEPTHS = 8
BEST_ANGLE_DEG = 15.0
ANGLE_SPREAD = 0.9
"""Half width at half maximum, in ln(angle), of a source camera's score. The score is a bell-shaped function of
ln(angle). The angle at a point is the angle between the rays from the point to the source camera and to the camera
whose depth is computed. The score is 1 at 15 degrees, 1/2 at 6 and at 37 degrees, and 1/7 at 130 degrees (a floor that
is seen from the opposite side)."""
MIN_GAIN = 0.01
"""Minimum increase of the objective, divided by the number of sampled points. A source camera is not added if the
increase is below this minimum."""


def select_sources(cameras: Sequence[Camera], index: int, nearest: float, farthest: float) -> list[int]:
    """Select up to 6 source cameras for the reference camera ``index``. If possible, each point in the reference
    camera's frustum is seen by two source cameras.

    Points are sampled in the frustum between the depths ``nearest`` and ``farthest``. The score of a source camera for
    a point depends on the angle between the rays of the two cameras to the point. The objective is the sum, over all
    sampled points, of the two best scores of each point. The selection is greedy: each step adds the camera that
    increases the objective most.
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
    """World points (N, 3) in the camera's frustum, on a grid over the image and at uniform steps of inverse depth."""
    middles = (np.arange(RAYS) + 0.5) / RAYS
    x, y = np.meshgrid(middles * camera.width, middles * camera.height)
    pixels = np.column_stack([x.ravel(), y.ravel()])
    depths = 1 / np.linspace(1 / farthest, 1 / nearest, DEPTHS)
    return camera.unproject(np.tile(pixels, (DEPTHS, 1)), np.repeat(depths, len(pixels)))


def _view_scores(camera: Camera, other: Camera, xyz: Array) -> Array:
    """Scores (N,) in [0, 1] of the source camera ``other`` for points. The score is 0 for points outside the image of
    ``other``."""
    pixels, depth = other.project(xyz)
    seen = other.is_in_image(pixels, depth)
    cosine = np.einsum("nc,nc->n", _directions(camera, xyz), _directions(other, xyz))
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return seen / (1 + (np.log(np.maximum(angle, 0.01) / BEST_ANGLE_DEG) / ANGLE_SPREAD) ** 2)


def _directions(camera: Camera, xyz: Array) -> Array:
    rays = camera.centre - xyz
    return np.asarray(rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12), np.float64)
