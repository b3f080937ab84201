"""Which pictures to compare one with: those that see what it sees, from not too near and not too far."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera

Array = NDArray[np.float64]

MOST_SOURCES = 6
RAYS = 12
DEPTHS = 8
BEST_ANGLE_DEG = 15.0
ANGLE_SPREAD = 0.9
"""Of the angle's logarithm: 6 and 37 degrees are worth half of 15; 130, a floor from the other side, a seventh."""
LEAST_GAIN = 0.01
"""Of all that a picture sees; a source that adds less is none."""


def best_sources(cameras: Sequence[Camera], index: int, nearest: float, farthest: float) -> list[int]:
    """Up to 6 cameras that together see most of what camera ``index`` sees between two depths, each place twice.

    Chosen one after the other by what each adds (a place counts by the angle between the rays).
    """
    xyz = _places(cameras[index], nearest, farthest)
    worth = np.array([_worth(cameras[index], other, xyz) for other in cameras])
    worth[index] = 0
    chosen: list[int] = []
    best = np.zeros((2, len(xyz)))
    while len(chosen) < MOST_SOURCES:
        before = np.broadcast_to(best, (len(cameras), *best.shape))
        with_each = np.sort(np.concatenate([before, worth[:, None]], axis=1), axis=1)[:, 1:]
        gains = with_each.sum(axis=(1, 2)) - best.sum()
        gains[chosen] = 0
        winner = int(gains.argmax())
        if gains[winner] < LEAST_GAIN * len(xyz):
            break
        chosen.append(winner)
        best = with_each[winner]
    return chosen


def _places(camera: Camera, nearest: float, farthest: float) -> Array:
    """(N, 3) world points all over the picture, evenly in inverse depth."""
    middles = (np.arange(RAYS) + 0.5) / RAYS
    x, y = np.meshgrid(middles * camera.width, middles * camera.height)
    rays = np.stack([x.ravel(), y.ravel(), np.ones(x.size)], axis=1) @ np.linalg.inv(camera.intrinsics).T
    depths = 1 / np.linspace(1 / farthest, 1 / nearest, DEPTHS)
    xyz_camera = (depths[:, None, None] * rays).reshape(-1, 3)
    return np.asarray((xyz_camera - camera.translation) @ camera.rotation, np.float64)


def _worth(camera: Camera, other: Camera, xyz: Array) -> Array:
    """(N,) in [0, 1], 0 where the other camera does not see the place."""
    pixels, depth = other.project(xyz)
    seen = other.is_in_image(pixels, depth)
    cosine = np.einsum("nc,nc->n", _directions(camera, xyz), _directions(other, xyz))
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return seen / (1 + (np.log(np.maximum(angle, 0.01) / BEST_ANGLE_DEG) / ANGLE_SPREAD) ** 2)


def _directions(camera: Camera, xyz: Array) -> Array:
    rays = camera.centre - xyz
    return np.asarray(rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12), np.float64)
