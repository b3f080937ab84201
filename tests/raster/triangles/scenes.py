"""Meshes for tests of the triangle operators."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def soup(
    rng: np.random.Generator, images: int = 2, vertices: int = 40, triangles: int = 60, *, behind: bool = False
) -> tuple[Tensor, Tensor]:
    """Return random triangles: pos (images, vertices, 4) and tri (triangles, 3).

    With ``behind``, half of the vertices have w < 0, so most triangles reach behind the camera. No two triangles have
    the same three vertices, because their depths would differ only by rounding.
    """
    pos = rng.standard_normal((images, vertices, 4)).astype(np.float32)
    if not behind:
        pos[..., 3] = np.abs(pos[..., 3]) + 0.3
    chosen: dict[frozenset[int], list[int]] = {}
    while len(chosen) < triangles:
        corners = rng.permutation(vertices)[:3].tolist()
        chosen.setdefault(frozenset(corners), corners)
    return torch.from_numpy(pos), torch.tensor(list(chosen.values()), dtype=torch.int32)


def grid(rng: np.random.Generator, cells: int, jitter: float = 0.24) -> tuple[Tensor, Tensor]:
    """Return a triangulated square with corners at +-1.2 and with shifted vertices: xy (V, 2) and tri (T, 3).

    The triangles have a random order, a random first vertex and a random orientation. With a ``jitter`` below 0.25
    cells, no triangles overlap.
    """
    steps = np.arange(cells + 1)
    xy = np.stack(np.meshgrid(steps, steps), -1).astype(np.float64)
    xy[1:-1, 1:-1] += rng.uniform(-jitter, jitter, (cells - 1, cells - 1, 2))
    xy = (2.4 * xy / cells - 1.2).reshape(-1, 2)
    corner = (steps[:-1, None] * (cells + 1) + steps[:-1]).ravel()
    lower = np.stack([corner, corner + 1, corner + cells + 1], 1)
    upper = np.stack([corner + 1, corner + cells + 2, corner + cells + 1], 1)
    tri = np.concatenate([lower, upper])
    tri = tri[rng.permutation(len(tri))]
    for row in tri:
        row[:] = row[rng.permutation(3)]
    return torch.from_numpy(xy.astype(np.float32)), torch.from_numpy(tri.astype(np.int32))


def each_alone(tri: Tensor) -> Tensor:
    """Return ranges (T, 2) that draw every triangle in a separate image."""
    return torch.stack([torch.arange(len(tri)), torch.ones(len(tri), dtype=torch.int64)], 1).int()


def with_w(xy: Tensor, z: float = 0.0) -> Tensor:
    """Return clip coordinates (V, 4) with the given z and w = 1."""
    ones = torch.ones_like(xy[:, :1])
    return torch.cat([xy, z * ones, ones], 1)
