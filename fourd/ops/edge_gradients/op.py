"""Gradients at visibility edges that do not change the image, in plain torch.

The search for edges dominates the time and is vectorised, so there is no kernel.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fourd.ops.antialias.pairs import EDGES, Pairs, crossed_edge, crossing_of_edge, find_pairs, line_of, see


def add_edge_gradients(color: Tensor, rast: Tensor, pos: Tensor, tri: Tensor, opposite: Tensor) -> Tensor:
    """Return ``color`` with gradients of moving edges, see :func:`fourd.raster.triangles.edge_gradients`."""
    clip = pos if pos.ndim == 3 else pos[None].expand(color.shape[0], -1, -1)
    for axis in (0, 1):
        pairs = find_pairs(rast, tri.shape[0], axis)
        flat = color.detach().reshape(-1, color.shape[-1])
        pairs = pairs[(flat[pairs.owner] != flat[pairs.other]).any(1)]
        edge = crossed_edge(pairs, clip.detach()[..., [0, 1, 3]], tri, opposite)
        silhouettes, others = pairs[edge >= 0], pairs[edge < 0]
        crossing = crossing_of_edge(silhouettes, clip[..., [0, 1, 3]], tri, edge[edge >= 0])
        color = _MovingEdges.apply(color, _finite(crossing), silhouettes.owner, silhouettes.other)
        intersections = others[_intersect(others, clip.detach(), tri)]
        crossing = _crossing_of_intersection(intersections, clip, tri)
        color = _MovingEdges.apply(color, _finite(crossing), intersections.owner, intersections.other)
    return color


class _MovingEdges(torch.autograd.Function):
    """The identity on ``color``. A pair of pixels differs by its edge: if the distance t of the edge from the owner
    grows by dt, one of the two pixels changes by dt (c_owner - c_other). The gradient is the mean of both cases."""

    @staticmethod
    def forward(ctx: Any, color: Tensor, crossing: Tensor, owner: Tensor, other: Tensor) -> Tensor:
        pixels = color.reshape(-1, color.shape[-1])
        ctx.save_for_backward(pixels[owner] - pixels[other], owner, other)
        return color.view_as(color)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        (gradient,) = gradients
        difference, owner, other = ctx.saved_tensors
        pixels = gradient.reshape(-1, gradient.shape[-1])
        to_crossing = 0.5 * ((pixels[owner] + pixels[other]) * difference).sum(1)
        to_owner = to_other = None
        return gradient, to_crossing, to_owner, to_other


def _finite(crossing: Tensor) -> Tensor:
    """Return the crossings, without gradients where they are not finite."""
    return torch.where(crossing.isfinite(), crossing, 0)


def _intersect(pairs: Pairs, clip: Tensor, tri: Tensor) -> Tensor:
    """Return whether both triangles of each pair contain both pixel centres, and swap their order between these."""
    two = pairs.other_triangle >= 0
    inside = two.clone()
    depth = []
    for triangle in (pairs.triangle, pairs.other_triangle.clamp(min=0)):
        value, fall, _, z, w = _lines(pairs, clip, tri, triangle)
        sign = torch.where(value.sum(1, keepdim=True) < 0, -1.0, 1.0).to(value)
        inside &= (value * sign >= 0).all(1) & ((value - fall) * sign >= 0).all(1)
        depth.append(torch.stack(((value * z).sum(1), ((value - fall) * z).sum(1)), 1) / (value * w).sum(1)[:, None])
    difference = depth[0] - depth[1]
    return inside & (difference[:, 0] <= 0) & (difference[:, 1] >= 0) & (difference[:, 1] > difference[:, 0])


def _crossing_of_intersection(pairs: Pairs, clip: Tensor, tri: Tensor) -> Tensor:
    """Return how far from the owner, in pixels, both triangles have the same z/w, which is linear in the image."""
    at_owner, slopes = [], []
    for triangle in (pairs.triangle, pairs.other_triangle):
        value, fall, _, z, w = _lines(pairs, clip, tri, triangle)
        volume = (value * w).sum(1)
        at_owner.append((value * z).sum(1) / volume)
        slopes.append((fall * z).sum(1) / volume)
    return (at_owner[0] - at_owner[1]) / (slopes[0] - slopes[1])


def _lines(pairs: Pairs, clip: Tensor, tri: Tensor, triangle: Tensor) -> tuple[Tensor, ...]:
    """Return the lines of the edges of ``triangle`` as :func:`line_of` does, and z and w of its vertices, each
    (N, 3)."""
    vertices = tri.long()[triangle]
    seen = see(pairs, clip[..., [0, 1, 3]], vertices)
    lines = [line_of(pairs, seen[:, one], seen[:, two]) for one, two in EDGES]
    z, w = clip[pairs.image[:, None], vertices][..., 2:].unbind(-1)
    return *(torch.stack(parts, 1) for parts in zip(*lines, strict=True)), z, w
