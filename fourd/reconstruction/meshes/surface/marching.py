"""Differentiable marching tetrahedra (DMTet, Shen et al. 2021, sec. 3.1.2)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

_EDGES = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
"""The six edges of a tetrahedron, each given by the indices of its two corners."""

_CUTS = (
    (-1, -1, -1, -1, -1, -1),
    (0, 1, 2, -1, -1, -1),
    (0, 4, 3, -1, -1, -1),
    (1, 2, 4, 1, 4, 3),
    (1, 3, 5, -1, -1, -1),
    (3, 5, 2, 3, 2, 0),
    (0, 4, 5, 0, 5, 1),
    (2, 4, 5, -1, -1, -1),
    (2, 5, 4, -1, -1, -1),
    (0, 1, 5, 0, 5, 4),
    (2, 5, 3, 2, 3, 0),
    (1, 5, 3, -1, -1, -1),
    (1, 3, 4, 1, 4, 2),
    (0, 3, 4, -1, -1, -1),
    (0, 2, 1, -1, -1, -1),
    (-1, -1, -1, -1, -1, -1),
)
"""The triangles in a tetrahedron, one row for each set of corners inside the surface: bit i of the row's index is set
if corner i is inside. Each triple of numbers is one triangle, given by the indices of the edges on which its vertices
lie, or -1 for no triangle. If the tetrahedron's determinant is positive, the triangles are counter-clockwise seen from
outside."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A triangle mesh extracted by marching tetrahedra.

    Attributes:
        xyz: (N, 3) positions of the vertices, differentiable.
        triangles: (M, 3) int64 vertex indices, counter-clockwise seen from outside.
        edges: (N, 2) int64 indices of grid vertices: the two ends of the grid edge on which each mesh vertex lies.
    """

    xyz: Tensor
    triangles: Tensor
    edges: Tensor


def marching_tetrahedra(xyz: Tensor, sdf: Tensor, tetrahedra: Tensor) -> Surface:
    """Extract the surface where the linearly interpolated ``sdf`` is zero.

    The surface cuts an edge with the ends a and b at (x_a * s_b - x_b * s_a) / (s_b - s_a), where x are positions and s
    are signed distances (DMTet, eq. 1). Each cut edge has one vertex, which all tetrahedra around the edge share, so
    the surface is closed if it does not reach the border of the grid.

    Args:
        xyz: (V, 3) floating-point positions of the grid's vertices, differentiable.
        sdf: (V,) signed distances of the same dtype, positive inside, differentiable. A vertex with the distance 0 is
            outside. Only the signs and the ratios of the distances matter.
        tetrahedra: (T, 4) int64 vertex indices with positive determinants, as in
            :class:`fourd.reconstruction.meshes.surface.grid.TetrahedralGrid`.

    Returns:
        The surface, which is empty if all distances have the same sign. The backward pass treats the set of triangles
        as constant.

    Raises:
        TypeError, ValueError: for a wrong dtype or shape, with a message that names the argument.
    """
    _check(xyz, sdf, tetrahedra)
    inside = sdf.detach() > 0
    corner_bits = torch.tensor([1, 2, 4, 8], device=sdf.device)
    code = (inside[tetrahedra] * corner_bits).sum(dim=1)
    is_cut = (code > 0) & (code < 15)
    tetrahedra, code = tetrahedra[is_cut], code[is_cut]
    ends = tetrahedra[:, torch.tensor(_EDGES, device=sdf.device)]
    ends = torch.stack([ends.amin(dim=2), ends.amax(dim=2)], dim=2)
    crosses = inside[ends[..., 0]] != inside[ends[..., 1]]
    keys = ends[..., 0] * len(sdf) + ends[..., 1]
    unique, index = torch.unique(keys[crosses], return_inverse=True)
    vertex_of_edge = torch.full_like(keys, -1)
    vertex_of_edge[crosses] = index
    edges = torch.stack([unique // max(len(sdf), 1), unique % max(len(sdf), 1)], dim=1)
    cuts = torch.tensor(_CUTS, device=sdf.device)[code]
    triangles = torch.gather(vertex_of_edge, 1, cuts.clamp(min=0)).reshape(-1, 2, 3)
    exists = cuts.reshape(-1, 2, 3)[..., 0] >= 0
    return Surface(_cut_points(xyz, sdf, edges), triangles[exists], edges)


def _cut_points(xyz: Tensor, sdf: Tensor, edges: Tensor) -> Tensor:
    """Compute the positions (N, 3) on the edges (N, 2) where the signed distance is zero."""
    first, second = edges.unbind(dim=1)
    share = sdf[first] / (sdf[first] - sdf[second])
    return xyz[first] + share[:, None] * (xyz[second] - xyz[first])


def _check(xyz: Tensor, sdf: Tensor, tetrahedra: Tensor) -> None:
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        raise ValueError(f"xyz: expected shape (V, 3), got {tuple(xyz.shape)}")
    if sdf.shape != xyz.shape[:1]:
        raise ValueError(f"sdf: expected shape ({len(xyz)},), got {tuple(sdf.shape)}")
    if tetrahedra.ndim != 2 or tetrahedra.shape[1] != 4:
        raise ValueError(f"tetrahedra: expected shape (T, 4), got {tuple(tetrahedra.shape)}")
    if not sdf.dtype.is_floating_point or xyz.dtype != sdf.dtype:
        raise TypeError(f"sdf: expected the floating-point dtype of xyz, {xyz.dtype}, got {sdf.dtype}")
    if tetrahedra.dtype != torch.int64:
        raise TypeError(f"tetrahedra: expected dtype int64, got {tetrahedra.dtype}; use tetrahedra.long()")
    if tetrahedra.numel() and (int(tetrahedra.min()) < 0 or int(tetrahedra.max()) >= len(sdf)):
        raise ValueError(f"tetrahedra: expected vertex indices from 0 to {len(sdf) - 1}, got others")
    if not bool(torch.isfinite(sdf.detach()).all()):
        raise ValueError("sdf: expected finite distances, got NaN or infinity")
