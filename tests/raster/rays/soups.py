"""Triangle soups and rays for the tests of ray tracing."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def random_soup(rng: np.random.Generator, count: int, size: float = 0.3) -> tuple[Tensor, Tensor]:
    """Triangles without common vertices, with centres in the cube [-1, 1]^3."""
    centres = rng.uniform(-1, 1, (count, 1, 3))
    corners = centres + rng.normal(0, size, (count, 3, 3))
    xyz = torch.from_numpy(corners.reshape(-1, 3).astype(np.float32))
    return xyz, torch.arange(3 * count, dtype=torch.int32).reshape(-1, 3)


def hard_soup(rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    """Triangles that are difficult for ray tracing: duplicates, coplanar layers, slivers, triangles that degenerate to
    a point, long and tiny triangles, and triangles with NaN and infinite coordinates.
    """
    corners = rng.uniform(-1, 1, (40, 3, 3))
    corners[5:10] = corners[0:5]  # Duplicates.
    corners[10:16, :, 2] = 0.25  # Coplanar.
    corners[16:19, 2] = corners[16:19, 0]  # Two equal corners.
    corners[19] = corners[19, :1]  # A point.
    corners[20:23, 2] = 0.5 * (corners[20:23, 0] + corners[20:23, 1]) + 1e-7  # Slivers.
    corners[23] *= 1e4
    corners[24] = corners[24, :1] + rng.normal(0, 1e-6, (3, 3))
    corners[25, 1, 1] = np.nan
    corners[26, 0, 2] = np.inf
    corners[27, 0, 0] = 1e30
    corners[28:34] = np.round(corners[28:34] * 2) / 2  # Corners on a coarse grid, which some rays hit exactly.
    xyz = torch.from_numpy(corners.reshape(-1, 3).astype(np.float32))
    return xyz, torch.arange(120, dtype=torch.int32).reshape(-1, 3)


def sphere(rows: int = 24) -> tuple[Tensor, Tensor]:
    """A closed sphere of radius 1 with ``2 * rows**2`` triangles. At the poles, some triangles have two equal
    corners."""
    theta, phi = np.meshgrid(np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, rows + 1), indexing="ij")
    xyz = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1).reshape(-1, 3)
    xyz[rows :: rows + 1] = xyz[0 :: rows + 1]  # The last column is equal to the first.
    a = (np.arange(rows)[:, None] * (rows + 1) + np.arange(rows)).reshape(-1)
    quads = [np.stack([a, a + 1, a + rows + 1], 1), np.stack([a + 1, a + rows + 2, a + rows + 1], 1)]
    return torch.from_numpy(xyz.astype(np.float32)), torch.from_numpy(np.concatenate(quads).astype(np.int32))


def random_rays(rng: np.random.Generator, count: int) -> tuple[Tensor, Tensor]:
    """Rays from the cube [-2, 2]^3 with directions of all lengths. Some rays are parallel to a coordinate axis or a
    coordinate plane. Some rays have origins and directions whose coordinates are multiples of 0.5."""
    origins, directions = rng.uniform(-2, 2, (count, 3)), rng.normal(0, 1, (count, 3))
    directions *= 10.0 ** rng.uniform(-6, 6, (count, 1))
    for k in range(0, count, 5):
        directions[k, rng.integers(3)] = 0.0
    for k in range(1, count, 5):
        directions[k] = np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0])
        origins[k] = np.round(origins[k] * 2) / 2
    for k in range(2, count, 5):
        origins[k], directions[k] = np.round(origins[k] * 2) / 2, rng.integers(-2, 3, 3) * 0.5
    return torch.from_numpy(origins.astype(np.float32)), torch.from_numpy(directions.astype(np.float32))


def rays_at_vertices(rng: np.random.Generator, xyz: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Rays through the vertices of a mesh, and through the midpoints of pairs of vertices."""
    finite = xyz[(xyz.abs() < 10).all(1)]
    picked = finite[torch.from_numpy(rng.integers(len(finite), size=(count, 2)))]
    is_vertex = torch.from_numpy(rng.random(count) < 0.5)[:, None]
    aim = torch.where(is_vertex, picked[:, 0], 0.5 * (picked[:, 0] + picked[:, 1]))
    origins = torch.from_numpy(rng.uniform(-3, 3, (count, 3)).astype(np.float32))
    return origins, aim - origins
