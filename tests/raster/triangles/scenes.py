"""Meshes for tests of the triangle operators."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def soup(
    rng: np.random.Generator, images: int = 2, vertices: int = 40, triangles: int = 60, *, behind: bool = False
) -> tuple[Tensor, Tensor]:
    """Return random triangles: pos (images, vertices, 4) and tri (triangles, 3).

    If ``behind`` is True, half of the vertices have w < 0, so most triangles reach behind the camera. The depths of two
    triangles with the same three vertices would differ only by rounding, so there are no such triangles.
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
    """Return a triangulated square with corners at +-1.2: xy (V, 2) and tri (T, 3).

    The inner vertices are shifted by up to ``jitter`` cells. The triangles and the vertices of each triangle have a
    random order. If ``jitter`` is below 0.25, no triangles overlap.
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
    """Return the argument ``ranges`` (T, 2) that draws each of the T triangles in a separate image."""
    return torch.stack([torch.arange(len(tri)), torch.ones(len(tri), dtype=torch.int64)], 1).int()


def with_w(xy: Tensor, z: float = 0.0) -> Tensor:
    """Return the clip coordinates (V, 4) of ``xy``, with the given z and with w = 1."""
    ones = torch.ones_like(xy[:, :1])
    return torch.cat([xy, z * ones, ones], 1)
