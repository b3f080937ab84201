"""Synthetic benchmark inputs of any size. Equal sizes give equal inputs."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.cameras import Camera, look_at
from fourd.rendering.ops.morton import morton_order
from fourd.scene.scene import BakedFrame, SceneManifest

SEED = 4
RADIUS_IN_SPACINGS = 1.3


def make_points(count: int) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Make N points on an ellipsoid: xyz (N, 3), radius (N,) and density (N,).

    The ellipsoid covers 40% of the image of :func:`make_camera`. Its surface has gaps and semi-transparent overlaps,
    and its front occludes its back.
    """
    rng = np.random.default_rng(SEED)
    directions = rng.standard_normal((count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    xyz = directions * np.array([0.75, 0.75, 0.9])
    radius = np.full(count, RADIUS_IN_SPACINGS * (8.0 / count) ** 0.5)
    density = rng.uniform(0.9, 1.0, count)
    return xyz.astype(np.float32), radius.astype(np.float32), density.astype(np.float32)


def make_cloud(count: int) -> dict[str, Tensor]:
    """Make the array arguments of ``render_points``: the points of :func:`make_points` in random colours."""
    xyz, radius, density = make_points(count)
    colours = np.random.default_rng(SEED + 1).random((count, 3), dtype=np.float32)
    arrays = {"xyz": xyz, "features": colours, "radius": radius, "density": density}
    return {name: torch.from_numpy(array) for name, array in arrays.items()}


def make_camera(width: int, height: int, angle: float = 0.0) -> Camera:
    """Make a camera at distance 3 from the z axis, rotated about the z axis by ``angle`` radians.

    The points of :func:`make_points` fill the image's height.
    """
    focal = 1.3 * height
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    centre = np.array([3 * np.sin(angle), -3 * np.cos(angle), 0.4])
    return look_at(centre, np.zeros(3), np.array([0.0, 0, 1]), intrinsics, width, height)


def make_baked_frame(count: int, views: int = 17, *, ordered: bool = False) -> tuple[BakedFrame, SceneManifest]:
    """Make a baked frame of the points from :func:`make_points`, and the manifest of its scene. The scene has ``views``
    source cameras in a ring.

    Args:
        ordered: whether to sort the points in Morton order, as in trained runs. If false, their order is random.
    """
    rng = np.random.default_rng(SEED + 2)
    xyz, radius, density = make_points(count)
    if ordered:
        xyz = xyz[morton_order(xyz)]
    frame = BakedFrame(
        xyz=xyz,
        radius=radius.astype(np.float16),
        density=density.astype(np.float16),
        sh=rng.normal(0, 0.3, (count, 3, 16)).astype(np.float16),
        blend_weights=rng.exponential(10, (count, views)).astype(np.float16),
        rgb=rng.integers(0, 256, (count, views, 3), dtype=np.uint8),
    )
    cameras = tuple(make_camera(512, 512, 2 * np.pi * view / views) for view in range(views))
    scene = SceneManifest(
        source_names=tuple(f"{view:02d}" for view in range(views)),
        source_cameras=cameras,
        focus=(0.0, 0.0, 0.0),
        bounds=((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)),
        frame_numbers=(0,),
        other_names=(),
        other_cameras=(),
        fps=30.0,
        producer="fourd bench",
    )
    return frame, scene


def make_planes(side: int = 64, levels: int = 4, features: int = 8, frames: int = 24) -> tuple[list[Tensor], list[int]]:
    """Make six K-Planes per level. Returns the planes, each with the shape (rows, columns, features), and a flat list
    with the two axes of each plane.

    A spatial axis has ``side`` samples at the first level, and twice as many at each level as at the previous one. The
    time axis has ``frames`` samples at every level.
    """
    generator = torch.Generator().manual_seed(SEED)
    pairs = ((0, 1), (0, 2), (1, 2), (0, 3), (1, 3), (2, 3))
    tensors, axes = [], []
    for level in range(levels):
        for first, second in pairs:
            rows = frames if second == 3 else side << level
            tensors.append(torch.randn(rows, side << level, features, generator=generator))
            axes += [first, second]
    return tensors, axes
