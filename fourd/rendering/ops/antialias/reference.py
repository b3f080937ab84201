"""Antialiasing of silhouette edges in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor

from fourd.rendering.ops.antialias.pairs import crossed_edge, crossing_of_edge, find_pairs


def antialias_reference(
    color: Tensor, rast: Tensor, pos: Tensor, tri: Tensor, opposite: Tensor, pos_gradient_boost: float = 1.0
) -> Tensor:
    """Compute the result of :func:`fourd.rendering.triangles.antialias` on any device, in float32 or float64.

    ``opposite`` is the result of :func:`fourd.rendering.ops.antialias.topology.opposite_vertices`.
    """
    clip = pos if pos.ndim == 3 else pos[None].expand(color.shape[0], -1, -1)
    clip = clip.detach() + (clip - clip.detach()) * pos_gradient_boost if pos_gradient_boost != 1 else clip
    clip = clip[..., [0, 1, 3]]
    out = pixels = color.reshape(-1, color.shape[-1])
    for axis in (0, 1):
        pairs = find_pairs(rast, tri.shape[0], axis)
        with torch.no_grad():
            edge = crossed_edge(pairs, clip, tri, opposite)
        pairs, edge = pairs[edge >= 0], edge[edge >= 0]
        crossing = crossing_of_edge(pairs, clip, tri, edge)
        crossing = crossing + (crossing.clamp(0, 1) - crossing).detach()
        # ``crossing`` is the distance, in pixels, from the centre of the owner (the pixel whose triangle is nearer) to
        # the edge. If it is below 0.5, the triangle ends inside the owner, so the other pixel's colour is blended into
        # the owner. Otherwise, the triangle extends into the other pixel, which gets some of the owner's colour.
        changes_owner = crossing < 0.5
        changed = torch.where(changes_owner, pairs.owner, pairs.other)
        source = torch.where(changes_owner, pairs.other, pairs.owner)
        weight = (0.5 - crossing).abs()[:, None]
        out = out.index_add(0, changed, weight * (pixels[source] - pixels[changed]))
    return out.reshape(color.shape)
