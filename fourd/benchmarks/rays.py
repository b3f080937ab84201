"""Benchmark computations: ray tracing."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.benchmarks.meshes import make_mesh
from fourd.benchmarks.peers import embree_tracer
from fourd.benchmarks.timing import Work
from fourd.benchmarks.workloads import make_camera
from fourd.rendering.rays import Bvh, trace
from fourd.scene.lenses.lens import Pinhole


def primary_rays(side: int) -> tuple[Tensor, Tensor]:
    """Return origins and directions (side^2, 3) of the rays through the pixel centres of the benchmarks' camera."""
    rays = Pinhole().rays(make_camera(side, side))
    return _float_tensor(rays.origins), _float_tensor(rays.directions)


def random_rays(count: int) -> tuple[Tensor, Tensor]:
    """Return incoherent rays, each from one random point to another in the cube [-1, 1]^3, which contains almost the
    whole mesh of :func:`make_mesh`."""
    generator = torch.Generator().manual_seed(count)
    ends = 2 * torch.rand(2, count, 3, generator=generator) - 1
    return ends[0], ends[1] - ends[0]


def ray_works(count: int, side: int) -> Iterator[tuple[str, Work, dict[str, Work]]]:
    """Yield benchmarks with about ``count`` triangles: building a BVH, refitting it, and tracing rays. Each benchmark
    is a tuple of its name, the function to time, and a dictionary of other implementations of the same computation."""
    xyz, tri = make_mesh(count)
    bvh = Bvh.build(xyz, tri)
    yield f"build a BVH over {count:,} triangles", lambda: Bvh.build(xyz, tri), {}
    yield f"refit a BVH over {count:,} triangles", lambda: bvh.refit(xyz), {}
    primary, scattered = primary_rays(side), random_rays(side * side)
    for name, rays, layers in (
        ("primary", primary, 1),
        ("primary", primary, 16),
        ("scattered", scattered, 1),
    ):
        label = f"trace {side * side:,} {name} rays, {count:,} triangles, K = {layers}"
        embree = embree_tracer(xyz, tri, *rays) if layers == 1 else None
        rivals = {"Embree, 1 thread": embree} if embree is not None else {}
        yield label, _tracing(bvh, xyz, rays, layers), rivals


def _tracing(bvh: Bvh, xyz: Tensor, rays: tuple[Tensor, Tensor], layers: int) -> Work:
    return lambda: trace(bvh, xyz, *rays, layers=layers)


def _float_tensor(array: NDArray[np.float64]) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, np.float32))
