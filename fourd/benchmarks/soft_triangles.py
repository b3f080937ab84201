"""Benchmark computations: the soft triangle renderers."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.benchmarks.timing import Work
from fourd.benchmarks.workloads import SEED, make_camera, make_points
from fourd.rendering.triangles import rasterize_soft, splat_triangles

CIRCUMRADIUS = 2.2
"""Circumradius of the triangles, as a multiple of the spacing of their centres. About 8 triangles overlap at each
pixel."""


def make_soup(count: int) -> dict[str, Tensor]:
    """Make the array arguments of ``splat_triangles``. The triangles are equilateral, have random colours, share no
    vertices, and lie in tangent planes of the ellipsoid of :func:`fourd.benchmarks.workloads.make_points`."""
    rng = np.random.default_rng(SEED)
    centres = make_points(count)[0].astype(np.float64)
    normals = _unit(centres)
    across = _unit(np.cross(normals, rng.standard_normal((count, 3))))
    along = np.cross(normals, across)
    angles = rng.uniform(0, 2 * np.pi, (count, 1)) + np.array([0, 2 * np.pi / 3, 4 * np.pi / 3])
    offsets = np.cos(angles)[..., None] * across[:, None] + np.sin(angles)[..., None] * along[:, None]
    xyz = centres[:, None] + CIRCUMRADIUS * (8.0 / count) ** 0.5 * offsets
    return {
        "xyz": torch.from_numpy(xyz.reshape(-1, 3).astype(np.float32)),
        "tri": torch.arange(3 * count, dtype=torch.int32).reshape(count, 3),
        "features": torch.from_numpy(rng.random((count, 3), dtype=np.float32)),
        "opacity": torch.from_numpy(rng.uniform(0.28, 0.78, count).astype(np.float32)),
        "sigma": torch.full((count,), 1.16),
    }


def splatting(count: int, side: int, backward: bool) -> Work:
    """Return a function that splats ``count`` triangles without depths and normals (``geometry=False``). If
    ``backward`` is true, the function only runs the backward pass, which computes the gradients."""
    soup, camera = make_soup(count), make_camera(side, side)
    if not backward:
        return lambda: splat_triangles(**soup, camera=camera, geometry=False)  # type: ignore[arg-type]
    free = [array.requires_grad_() for name, array in soup.items() if name != "tri"]
    image = splat_triangles(**soup, camera=camera, geometry=False)  # type: ignore[arg-type]
    total = image.features.sum() + image.alpha.sum()
    return lambda: torch.autograd.grad(total, free, retain_graph=True)


def make_sphere(count: int) -> tuple[Tensor, Tensor]:
    """Make a closed sphere of about ``count`` triangles: vertices (V, 3) float32 and triangles (T, 3) int32. It covers
    most of the image of ``make_camera``."""
    rows = max(2, round((count / 4) ** 0.5) + 1)
    columns = 2 * rows
    theta, phi = np.meshgrid(np.linspace(0, np.pi, rows + 1), np.arange(columns) * 2 * np.pi / columns, indexing="ij")
    xyz = 0.9 * np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    row, column = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    a, b = row * columns + column, row * columns + (column + 1) % columns
    upper = np.stack([a, b + columns, b], axis=-1)[1:]
    lower = np.stack([a, a + columns, b + columns], axis=-1)[:-1]
    tri = np.concatenate([upper.reshape(-1, 3), lower.reshape(-1, 3)])
    return torch.from_numpy(xyz.reshape(-1, 3).astype(np.float32)), torch.from_numpy(tri.astype(np.int32))


def soft_silhouette(count: int, side: int, layers: int) -> Work:
    """Return a function that renders a soft silhouette and computes its gradient with respect to the vertices."""
    xyz, tri = make_sphere(count)
    xyz.requires_grad_()
    features, camera = torch.ones(len(tri), 1), make_camera(side, side)

    def work() -> object:
        alpha = rasterize_soft(xyz, tri, features, camera, sigma=1e-4, layers=layers)[1]
        return torch.autograd.grad(alpha.square().sum(), xyz)

    return work


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
