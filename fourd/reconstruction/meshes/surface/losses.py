"""Losses that keep a triangle mesh smooth and its triangles regular."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class MeshTopology:
    """The edges of a triangle mesh.

    Attributes:
        edges: (E, 2) int64 vertex indices of each edge, the smaller index first. Each edge occurs once.
        neighbours: (P, 2) int64 indices of pairs of triangles that share an edge. An edge with n triangles gives n - 1
            pairs.
        vertex_count: number of vertices.
    """

    edges: Tensor
    neighbours: Tensor
    vertex_count: int

    @staticmethod
    def of(triangles: Tensor, vertex_count: int) -> MeshTopology:
        """Find the edges of ``triangles`` (M, 3), whose integer vertex indices are below ``vertex_count``."""
        triangles = triangles.long()
        sides = torch.cat([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
        owner = torch.arange(len(triangles), device=triangles.device).repeat(3)
        keys = sides.amin(dim=1) * vertex_count + sides.amax(dim=1)
        keys, order = torch.sort(keys, stable=True)
        owner = owner[order]
        shared = keys[1:] == keys[:-1]
        unique = torch.unique_consecutive(keys)
        edges = torch.stack([unique // max(vertex_count, 1), unique % max(vertex_count, 1)], dim=1)
        return MeshTopology(edges, torch.stack([owner[:-1][shared], owner[1:][shared]], dim=1), vertex_count)


def laplacian_loss(xyz: Tensor, topology: MeshTopology) -> Tensor:
    """Return the mean squared length of the uniform Laplacian, the vector from a vertex to the mean of its neighbours.

    Minimising the uniform Laplacian (Desbrun et al. 1999) moves vertices along the normal, which smooths the surface,
    and in the tangent plane, which makes triangles regular. Vertices without neighbours are ignored.

    Args:
        xyz: (N, 3) vertices, differentiable.
        topology: edges of the mesh.

    Returns:
        a scalar in squared world units, 0 for a mesh without edges.
    """
    first, second = topology.edges.unbind(dim=1)
    degree = torch.zeros(len(xyz), dtype=xyz.dtype, device=xyz.device)
    one = torch.ones(len(first), dtype=xyz.dtype, device=xyz.device)
    degree = degree.index_add(0, first, one).index_add(0, second, one)
    total = torch.zeros_like(xyz).index_add(0, first, xyz[second]).index_add(0, second, xyz[first])
    used = degree > 0
    offset = total[used] / degree[used, None] - xyz[used]
    return offset.square().sum() / max(len(offset), 1)


def normal_consistency_loss(xyz: Tensor, triangles: Tensor, topology: MeshTopology) -> Tensor:
    """Return the mean of 1 - c, where c is the cosine of the angle between the normals of two triangles that share an
    edge.

    The loss of a flat mesh is 0. A triangle without area has a zero normal, so each pair that contains it contributes
    the loss 1 and no gradient.

    Args:
        xyz: (N, 3) vertices, differentiable.
        triangles: (M, 3) integer vertex indices with a consistent orientation.
        topology: edges of the mesh.

    Returns:
        a scalar in [0, 2], 0 for a mesh without neighbouring triangles.
    """
    normals = triangle_normals(xyz, triangles)
    cosine = (normals[topology.neighbours[:, 0]] * normals[topology.neighbours[:, 1]]).sum(dim=1)
    return (1 - cosine).sum() / max(len(cosine), 1)


def edge_length_loss(xyz: Tensor, topology: MeshTopology, length: float | None = None) -> Tensor:
    """Return the mean of (edge length - ``length``)^2 / ``length``^2 over all edges.

    Args:
        xyz: (N, 3) vertices, differentiable.
        topology: edges of the mesh.
        length: target length of the edges in world units, more than 0. If ``length`` is None, the target length is the
            mean length of the edges, which is treated as a constant.

    Returns:
        a dimensionless scalar, 0 for a mesh without edges.

    Raises:
        ValueError: if ``length`` is not positive.
    """
    if length is not None and not length > 0:
        raise ValueError(f"length: expected more than 0, got {length}")
    first, second = topology.edges.unbind(dim=1)
    if len(first) == 0:
        return xyz.sum() * 0
    # The small constant keeps the gradient finite for edges of length 0.
    lengths = ((xyz[first] - xyz[second]).square().sum(dim=1) + 1e-24).sqrt()
    wanted = lengths.detach().mean().clamp(min=1e-12) if length is None else length
    return ((lengths - wanted) / wanted).square().mean()


def triangle_normals(xyz: Tensor, triangles: Tensor) -> Tensor:
    """Compute the unit normals (M, 3) of triangles (M, 3). A normal points to the side from which the triangle is
    counter-clockwise, and is 0 if the triangle has no area.

    The normals are differentiable in ``xyz`` (N, 3).
    """
    a, b, c = (xyz[triangles[:, corner].long()] for corner in range(3))
    return torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=1, eps=1e-20)


def vertex_normals(xyz: Tensor, triangles: Tensor) -> Tensor:
    """Compute the differentiable unit normals (N, 3) of the vertices. A vertex normal is the area-weighted
    mean of the adjacent triangles' normals, normalised to unit length."""
    triangles = triangles.long()
    a, b, c = (xyz[triangles[:, corner]] for corner in range(3))
    weighted = torch.linalg.cross(b - a, c - a)
    total = torch.zeros_like(xyz)
    for corner in range(3):
        total = total.index_add(0, triangles[:, corner], weighted)
    return torch.nn.functional.normalize(total, dim=1, eps=1e-20)
