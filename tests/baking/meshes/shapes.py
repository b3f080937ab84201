"""Meshes with known depth and normals, and a camera that sees them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.formats.mesh import Mesh

FOCAL = 200.0
DISTANCE = 3.0


def front_camera(size: int) -> Camera:
    """A camera at the origin that looks along +z, with the intrinsics of the camera in tests/stylize/surfaces.py."""
    intrinsics = np.array([[FOCAL, 0, size / 2], [0, FOCAL, size / 2], [0, 0, 1]])
    return Camera(intrinsics, np.eye(3), np.zeros(3), size, size)


def sphere(radius: float = 1.0, rings: int = 200, *, colour: tuple[int, int, int] = (200, 120, 60)) -> Mesh:
    """A sphere around (0, 0, DISTANCE) with exact normals."""
    polar, azimuth = np.meshgrid(np.linspace(0, np.pi, rings), np.linspace(0, 2 * np.pi, 2 * rings), indexing="ij")
    normals = np.stack([np.sin(polar) * np.cos(azimuth), np.cos(polar), np.sin(polar) * np.sin(azimuth)], 2)
    index = np.arange(polar.size).reshape(polar.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    triangles = np.concatenate([np.stack(t, 2).reshape(-1, 3) for t in ((a, b, c), (b, d, c))])
    return Mesh(
        xyz=(radius * normals.reshape(-1, 3) + [0, 0, DISTANCE]).astype(np.float32),
        triangles=triangles.astype(np.int32),
        normals=normals.reshape(-1, 3).astype(np.float32),
        rgb=np.tile(np.array(colour, np.uint8), (polar.size, 1)),
    )


def plane(normal: tuple[float, float, float], texture: NDArray[np.uint8] | None = None) -> Mesh:
    """A plane through (0, 0, DISTANCE) that fills the view of :func:`front_camera` and extends past it."""
    unit = np.asarray(normal) / np.linalg.norm(normal)
    corners = np.array([[x, y, 0] for y in (-2.9, 2.9) for x in (-2.9, 2.9)])
    corners[:, 2] = DISTANCE - (corners @ unit) / unit[2]
    uv = np.array([[0, 0], [1, 0], [0, 1], [1, 1]], np.float32)
    return Mesh(
        xyz=corners.astype(np.float32),
        triangles=np.array([[0, 1, 2], [1, 3, 2]], np.int32),
        uv=None if texture is None else uv,
        texture=texture,
    )
