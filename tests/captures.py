"""A small capture on disk. The images show a moving, textured ball and are rendered from a ring of cameras."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera, look_at
from fourd.recording.capture import write_calibration
from fourd.rendering.ops.points.arrays import render_points_numpy


def ring_cameras(count: int, size: int) -> list[Camera]:
    """Cameras around the origin at two heights, at a horizontal distance of 2 m."""
    intrinsics = np.array([[1.1 * size, 0, size / 2], [0, 1.1 * size, size / 2], [0, 0, 1]])
    cameras = []
    for index in range(count):
        angle = 2 * np.pi * index / count
        centre = np.array([2 * np.cos(angle), 2 * np.sin(angle), 0.5 if index % 2 else -0.2])
        cameras.append(look_at(centre, np.zeros(3), np.array([0.0, 0.0, 1.0]), intrinsics, size, size))
    return cameras


def write_ball_capture(folder: Path, *, cameras: int = 8, frames: int = 2, size: int = 64) -> Path:
    """Write images, masks and calibration into ``folder``. The ball moves without rotation."""
    views = ring_cameras(cameras, size)
    names = [f"{index:02d}" for index in range(cameras)]
    write_calibration(folder, names, views)
    directions = sphere(6000)
    stripes = 0.5 + 0.4 * np.sin(9 * directions @ np.array([[1.0, 0.3, 0], [0, 1, 0.4], [0.2, 0, 1]]))
    for frame in range(frames):
        centre = np.array([0.12 * np.sin(frame), 0.1 * np.cos(frame), 0.0])
        xyz = (0.4 * directions + centre).astype(np.float32)
        for name, view in zip(names, views, strict=True):
            _write_view(folder, name, frame, view, xyz, stripes.astype(np.float32))
    return folder


def _write_view(
    folder: Path, name: str, frame: int, view: Camera, xyz: NDArray[np.float32], rgb: NDArray[np.float32]
) -> None:
    radius, density = np.full(len(xyz), 0.02, np.float32), np.ones(len(xyz), np.float32)
    colour, alpha, _ = render_points_numpy(xyz, rgb, radius, density, view, layers=15, near=0.01)
    whole = colour + (1 - alpha)[..., None] * np.float32(0.35)
    for kind, suffix, picture in (("images", "png", whole[..., ::-1]), ("masks", "png", alpha)):
        path = folder / kind / name / f"{frame:06d}.{suffix}"
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), (picture.clip(0, 1) * 255 + 0.5).astype(np.uint8))


def sphere(count: int) -> NDArray[np.float64]:
    """Evenly distributed unit vectors on a Fibonacci lattice."""
    index = np.arange(count) + 0.5
    z, angle = 1 - 2 * index / count, np.pi * (1 + 5**0.5) * index
    r = np.sqrt(1 - z**2)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
