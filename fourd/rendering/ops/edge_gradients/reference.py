"""Gradients that arise because visibility edges move with the vertices, in plain torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.antialias.pairs import EDGES, Pairs, crossed_edge, crossing_of_edge, find_pairs, line_of, see


def add_edge_gradients_reference(color: Tensor, rast: Tensor, pos: Tensor, tri: Tensor, opposite: Tensor) -> Tensor:
    """Compute the result of :func:`fourd.rendering.triangles.edge_gradients` on any device, in float32 or float64.

    ``opposite`` is the result of :func:`fourd.rendering.ops.antialias.topology.opposite_vertices`.
    """
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
    """Returns ``color`` unchanged.

    A visibility edge passes between the centres of two neighbouring pixels: the owner, whose triangle is nearer, and
    the other pixel. The argument ``crossing`` (N,) contains the distance in pixels from the owner's centre to the edge,
    for each of N such pairs, and the backward pass computes the gradient of this distance. If the edge moves away from
    the owner by dt pixels, the colour of the pixel that contains the edge changes by ``dt * (c_owner - c_other)``,
    where c_owner and c_other are the colours of the two pixels. Either the owner or the other pixel can contain the
    edge, so the gradient is the mean of the gradients for these two cases.
    """

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
    """Replace non-finite crossings by 0, so that they have no gradient."""
    return torch.where(crossing.isfinite(), crossing, 0)


@dataclass(frozen=True)
class _Planes:
    """The depth z/w of one triangle for each of N pairs of pixels, as a linear function of the image position. The
    origin is the centre of the pair's owner (the pixel whose triangle is nearer).

    Attributes:
        contains_pair: (N,) true if the triangle contains the centres of both pixels.
        depth: (N,) z/w at the centre of the owner.
        fall: (N,) decrease of z/w per pixel along the pair, from the owner to the other pixel.
        fall_across: (N,) decrease of z/w per pixel perpendicular to the pair: towards the next row if the pair lies in
            a row, and towards the next column if it lies in a column.
    """

    contains_pair: Tensor
    depth: Tensor
    fall: Tensor
    fall_across: Tensor


def _planes_of(pairs: Pairs, clip: Tensor, tri: Tensor, triangle: Tensor) -> _Planes:
    vertices = tri.long()[triangle]
    seen = see(pairs, clip[..., [0, 1, 3]], vertices)
    lines = [line_of(pairs, seen[:, one], seen[:, two]) for one, two in EDGES]
    value, along, across = (torch.stack(parts, 1) for parts in zip(*lines, strict=True))
    z, w = clip[pairs.image[:, None], vertices][..., 2:].unbind(-1)
    volume = _dot(value, w)
    sign = torch.where(value[:, 0] + value[:, 1] + value[:, 2] < 0, -1.0, 1.0).to(value)[:, None]
    inside = (value * sign >= 0).all(1) & ((value - along) * sign >= 0).all(1)
    return _Planes(inside, _dot(value, z) / volume, _dot(along, z) / volume, _dot(across, z) / volume)


def _dot(one: Tensor, two: Tensor) -> Tensor:
    """Return the dot products (N,) of rows (N, 3), with the kernel's order of summation."""
    return one[:, 0] * two[:, 0] + one[:, 1] * two[:, 1] + one[:, 2] * two[:, 2]


def _intersect(pairs: Pairs, clip: Tensor, tri: Tensor) -> Tensor:
    """Return a mask of the pairs whose triangles intersect between the pixel centres.

    The triangles of a pair intersect if each of them contains both pixel centres and is nearer at one of the centres.
    As with silhouette edges, intersection lines at less than 45 degrees to the segment between the centres are ignored.
    Triangles that share an edge are not tested, because they intersect only along the edge.
    """
    corners = tri.long()
    own, other = corners[pairs.triangle], corners[pairs.other_triangle.clamp(min=0)]
    common = (own[:, :, None] == other[:, None, :]).any(2).sum(1)
    one = _planes_of(pairs, clip, tri, pairs.triangle)
    two = _planes_of(pairs, clip, tri, pairs.other_triangle.clamp(min=0))
    gap, growth = one.depth - two.depth, two.fall - one.fall
    across = (two.fall_across - one.fall_across).abs()
    perpendicular = (growth >= across) if pairs.axis == 0 else (growth > across)
    inside = (pairs.other_triangle >= 0) & (common < 2) & one.contains_pair & two.contains_pair
    return inside & perpendicular & (growth > 0) & (gap <= 0) & (gap + growth >= 0)


def _crossing_of_intersection(pairs: Pairs, clip: Tensor, tri: Tensor) -> Tensor:
    """Return the distance (N,), in pixels, along the pair from the centre of the owner (the pixel whose triangle is
    nearer) to the point where the triangles of both pixels have the same depth z/w. The depth z/w of a triangle is
    linear in the image position."""
    one = _planes_of(pairs, clip, tri, pairs.triangle)
    two = _planes_of(pairs, clip, tri, pairs.other_triangle)
    return (one.depth - two.depth) / (one.fall - two.fall)
