"""Captures in memory with exact silhouettes of analytic shapes, seen by a ring of cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from tests.captures import ring_cameras

Picture = NDArray[np.uint8]
Hit = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.bool_]]


def ball(centre: tuple[float, float, float], radius: float) -> Hit:
    """Create a function that returns which rays intersect a ball. The rays have one origin (3,) and directions (N,
    3)."""

    def hit(origin: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.bool_]:
        towards = np.asarray(centre) - origin
        along = directions @ towards
        return (towards @ towards - along**2 < radius**2) & (along > 0)

    return hit


def mask(camera: Camera, shapes: list[Hit]) -> Picture:
    """Render a matte (H, W) with 3 x 3 rays per pixel."""
    total = np.zeros(camera.height * camera.width)
    for dy in (1 / 6, 0.5, 5 / 6):
        for dx in (1 / 6, 0.5, 5 / 6):
            rows, columns = np.indices((camera.height, camera.width))
            pixels = np.stack([columns + dx, rows + dy, np.ones_like(rows)], axis=-1).reshape(-1, 3)
            rays = pixels @ np.linalg.inv(camera.intrinsics).T @ camera.rotation
            rays /= np.linalg.norm(rays, axis=1, keepdims=True)
            total += np.any([shape(camera.centre, rays) for shape in shapes], axis=0)
    return np.rint(total / 9 * 255).astype(np.uint8).reshape(camera.height, camera.width)


@dataclass
class MemoryCapture:
    """A capture in memory that implements MaskSource and counts how often masks are read."""

    cameras: tuple[Camera, ...]
    masks: list[list[Picture]]
    path: Path = Path("memory")
    decoded: int = 0
    images: list[Picture] = field(default_factory=list)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"{index:02d}" for index in range(len(self.cameras)))

    @property
    def frame_count(self) -> int:
        return len(self.masks)

    @property
    def frame_numbers(self) -> tuple[int, ...]:
        return tuple(range(len(self.masks)))

    def mask(self, camera: int, frame: int) -> Picture:
        self.decoded += 1
        return self.masks[frame][camera]

    def image(self, camera: int, frame: int) -> Picture:
        view = self.cameras[camera]
        return self.images[camera] if self.images else np.full((view.height, view.width, 3), 200, np.uint8)


def moving_ball(frames: int = 2, views: int = 12, size: int = 96) -> MemoryCapture:
    """A ball of radius 0.3 that moves along x."""
    cameras = tuple(ring_cameras(views, size))
    centres = [(0.1 * frame, 0.0, 0.05) for frame in range(frames)]
    return MemoryCapture(cameras, [[mask(camera, [ball(centre, 0.3)]) for camera in cameras] for centre in centres])
