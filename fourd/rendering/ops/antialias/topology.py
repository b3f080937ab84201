"""Finds the neighbours of triangles across their edges."""

from __future__ import annotations

import torch
from torch import Tensor

NO_VERTEX = -1
"""Marks edges of a triangle across which it has no neighbour."""


@torch.no_grad()
def opposite_vertices(tri: Tensor, vertices: int | None = None) -> Tensor:
    """For each edge of each triangle, find the third vertex of the triangle's neighbour across the edge.

    Return (T, 3) int32 vertex indices. Column i belongs to the edge opposite to vertex i, and is -1 if the triangle has
    no neighbour across it. The function is not differentiable.

    Triangles share an edge if they contain the edge's two vertices, in any order. An edge has two sides. The vertex
    opposite to the edge in its first triangle (the one with the smallest index) stands for the first side, and the
    first different opposite vertex stands for the second side. So triangles with the same three vertices, such as the
    two faces of a double-sided surface, are on the same side, and their neighbour is the vertex of the other side. On
    an edge with more than two different opposite vertices, triangles with a third one have no neighbour, as in
    nvdiffrast.

    Args:
        tri: (T, 3) int32 vertex indices. Triangles that contain a vertex twice have no neighbours and are nobody's
            neighbour.
        vertices: number of vertices; triangles with an index out of range are treated in the same way. If it is None,
            only negative indices are out of range.
    """
    count = tri.shape[0]
    corners = tri.long()
    is_used = (corners != corners.roll(1, 1)).all(1) & (corners >= 0).all(1)
    if vertices is not None:
        is_used &= (corners < vertices).all(1)
    out = torch.full((3 * count,), NO_VERTEX, dtype=torch.int32, device=tri.device)
    at = is_used.repeat_interleave(3).nonzero()[:, 0]
    if len(at) == 0:
        return out.reshape(count, 3)
    ends = corners[:, [[1, 2], [2, 0], [0, 1]]].reshape(3 * count, 2)[at].sort(1).values
    # A stable sort keeps the order of the triangles at each edge.
    edge_key, order = ((ends[:, 0] << 32) | ends[:, 1]).sort(stable=True)
    at, vertex = at[order], corners.reshape(-1)[at[order]]
    edge = torch.cat([torch.zeros_like(edge_key[:1]), (edge_key[1:] != edge_key[:-1]).long().cumsum(0)])
    first, second = _sides(edge, vertex)
    out[at] = torch.where(vertex == first, second, torch.where(vertex == second, first, NO_VERTEX)).int()
    return out.reshape(count, 3)


def _sides(edge: Tensor, vertex: Tensor) -> tuple[Tensor, Tensor]:
    """Return the first vertex of each entry's edge, and the first different one, or -1 if there is none.

    Both arguments and results are (N,). Equal values of ``edge`` are adjacent and count up from 0.
    """
    position = torch.arange(len(edge), device=edge.device)
    edges = int(edge[-1]) + 1
    start = position.new_full((edges,), len(edge)).scatter_reduce(0, edge, position, "amin")
    first = vertex[start][edge]
    elsewhere = torch.where(vertex == first, len(edge), position)
    second_at = position.new_full((edges,), len(edge)).scatter_reduce(0, edge, elsewhere, "amin")
    padded = torch.cat([vertex, vertex.new_full((1,), NO_VERTEX)])
    return first, padded[second_at][edge]
