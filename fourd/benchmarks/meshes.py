"""Benchmark computations: rasterization, interpolation and silhouette gradients."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from fourd.benchmarks.timing import Work
from fourd.benchmarks.workloads import make_camera
from fourd.rendering.triangles import (
    antialias,
    antialias_construct_topology,
    clip_matrix,
    edge_gradients,
    interpolate,
    rasterize,
)

DEPTH_LIMITS = (0.5, 10.0)
"""Depths of the near and the far plane, in the mesh's units of length."""


def make_mesh(count: int) -> tuple[Tensor, Tensor]:
    """Make a closed, wavy surface of about ``count`` triangles: xyz (V, 3) float32 and tri (T, 3) int32.

    In the image of :func:`fourd.benchmarks.workloads.make_camera`, the surface covers 63% of the pixels. Half of
    its triangles are seen from behind.
    """
    cells = max(2, round(math.sqrt(count / 2)))
    steps = torch.arange(cells + 1, dtype=torch.float64) / cells
    polar, azimuth = torch.meshgrid(math.pi * steps, 2 * math.pi * steps, indexing="ij")
    radius = 0.95 + 0.08 * torch.sin(5 * polar) * torch.cos(7 * azimuth)
    xyz = torch.stack([polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos()], -1) * radius[..., None]
    first = (torch.arange(cells)[:, None] * (cells + 1) + torch.arange(cells)).reshape(-1)
    right, below = first + 1, first + cells + 1
    tri = torch.cat([torch.stack([first, right, below], 1), torch.stack([right, below + 1, below], 1)])
    order = torch.argsort(tri.amin(1), stable=True)  # Consecutive triangles are near each other on the surface.
    return xyz.reshape(-1, 3).float(), tri[order].int()


def project(xyz: Tensor, side: int) -> Tensor:
    """Return the clip coordinates (1, V, 4) of points for a square image."""
    matrix = clip_matrix(make_camera(side, side), *DEPTH_LIMITS)
    return (torch.cat([xyz, torch.ones_like(xyz[:, :1])], 1) @ matrix.T)[None].contiguous()


def rasterizing(count: int, side: int, backward: bool) -> Work:
    """Return a function that rasterizes about ``count`` triangles with screen-space derivatives. If ``backward`` is
    true, the function only runs the backward pass, which computes the gradients with respect to the positions."""
    xyz, tri = make_mesh(count)
    pos = project(xyz, side)
    if not backward:
        return lambda: rasterize(pos, tri, (side, side))
    pos.requires_grad_()
    outputs = rasterize(pos, tri, (side, side))
    upstream = [torch.ones_like(output) for output in outputs]
    return lambda: torch.autograd.grad(outputs, pos, upstream, retain_graph=True)


def interpolating(count: int, side: int, backward: bool) -> Work:
    """Return a function that interpolates three channels. If ``backward`` is true, the function only runs the backward
    pass, which computes the gradients with respect to the attributes and the barycentric weights."""
    xyz, tri = make_mesh(count)
    rast, _ = rasterize(project(xyz, side), tri, (side, side))
    if not backward:
        return lambda: interpolate(xyz, rast, tri)
    leaves = (xyz.requires_grad_(), rast.requires_grad_())
    out, _ = interpolate(*leaves, tri)
    upstream = torch.ones_like(out)
    return lambda: torch.autograd.grad(out, leaves, upstream, retain_graph=True)


def antialiasing(count: int, side: int, *, changes_image: bool = True) -> Work:
    """Return a function that antialiases three channels and computes the gradients with respect to the colours and
    positions. The mesh's edge topology, which antialiasing needs, is built only once, before the timing. If
    ``changes_image`` is false, ``antialias`` is replaced by :func:`fourd.rendering.triangles.edge_gradients`, which
    computes gradients at edges but returns the image unchanged."""
    xyz, tri = make_mesh(count)
    topology = antialias_construct_topology(tri)
    pos = project(xyz, side)
    rast, _ = rasterize(pos, tri, (side, side))
    generator = torch.Generator().manual_seed(count)
    color, _ = interpolate(torch.rand(len(xyz), 3, generator=generator), rast, tri)
    leaves = (color.requires_grad_(), pos.requires_grad_())
    upstream = torch.randn(color.shape, generator=generator)
    blend = antialias if changes_image else edge_gradients
    return lambda: torch.autograd.grad(blend(color, rast, pos, tri, topology), leaves, upstream)
