"""Finds the neighbours of triangles across their edges."""

from __future__ import annotations

import torch
from torch import Tensor

NO_VERTEX = -1
"""Marks edges that belong to only one triangle or to more than two, and thus have no unique opposite vertex."""


@torch.no_grad()
def opposite_vertices(tri: Tensor) -> Tensor:
    """For each edge of each triangle, find the third vertex of the triangle's neighbour across the edge.

    Return (T, 3) int32 vertex indices. Column i belongs to the edge opposite to vertex i, and is -1 if the edge belongs
    to only one triangle or to more than two. Two triangles share an edge if both contain the edge's two vertices, in
    any order. The function is not differentiable.

    Args:
        tri: (T, 3) int32 vertex indices.
    """
    count = tri.shape[0]
    corners = tri.long()
    ends = corners[:, [[1, 2], [2, 0], [0, 1]]].reshape(3 * count, 2).sort(1).values
    key = (ends[:, 0] << 32) | ends[:, 1]
    key, order = key.sort()
    # An edge belongs to exactly two triangles if its key (its two vertex indices) occurs exactly twice.
    same = torch.zeros(3 * count + 1, dtype=torch.bool, device=tri.device)
    same[1:-1] = key[1:] == key[:-1]
    before, after = same[:-1], same[1:]
    second = before & ~after
    second[1:] &= ~before[:-1]
    at = second.nonzero()[:, 0]
    one, two = order[at - 1], order[at]
    out = torch.full((3 * count,), NO_VERTEX, dtype=torch.int32, device=tri.device)
    vertices = tri.reshape(-1)
    out[one], out[two] = vertices[two], vertices[one]
    return out.reshape(count, 3)
