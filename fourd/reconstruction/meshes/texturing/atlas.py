"""Texture atlases, which pack the charts of a mesh into a square texture, computed with the library xatlas."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from fourd.rendering.ops.meshes.ids import decode_ids
from fourd.rendering.triangles import rasterize

PADDING_TEXELS = 2
"""Distance between charts in texels, large enough that bilinear samples at a chart's border include no texels of other
charts."""


@dataclass(frozen=True, eq=False)
class Atlas:
    """Charts of a mesh. A vertex at a chart border occurs once for each chart that contains it.

    Attributes:
        source: (N,) int64 index of each atlas vertex in the original mesh.
        triangles: (M, 3) int32 vertex indices, in the order of the original triangles.
        uv: (N, 2) float32 texture coordinates in [0, 1]. (0, 0) is the upper left corner of the texture.
        chart_count: number of charts.
    """

    source: NDArray[np.int64]
    triangles: NDArray[np.int32]
    uv: NDArray[np.float32]
    chart_count: int


@dataclass(frozen=True, eq=False)
class Texels:
    """The texels that the charts of an atlas cover.

    Attributes:
        covered: (S, S) bool, true for texels whose centre lies in a chart.
        triangle: (P,) int64 index of the triangle that contains each covered texel, in row-major order of the texels.
        weights: (P, 3) float32 barycentric coordinates of each covered texel in its triangle.
    """

    covered: NDArray[np.bool_]
    triangle: NDArray[np.int64]
    weights: NDArray[np.float32]

    def interpolate(self, values: NDArray[np.float32], triangles: NDArray[np.integer]) -> NDArray[np.float32]:
        """Interpolate the vertex attributes ``values`` (N, C) at the covered texels. Return (P, C).

        ``triangles`` (M, 3) are indices into ``values``.
        """
        corners = triangles[self.triangle]
        return np.asarray(sum(values[corners[:, k]] * self.weights[:, k : k + 1] for k in range(3)), np.float32)


def build_atlas(xyz: NDArray[np.float32], triangles: NDArray[np.integer], size: int) -> Atlas:
    """Cut a mesh into charts, flatten the charts with little distortion, and pack them into a square texture.

    Args:
        xyz: (N, 3) finite vertices.
        triangles: (M, 3) vertex indices, at least one triangle.
        size: side length of the texture in texels, at least 16.

    Raises:
        ValueError: if the mesh is empty, a vertex is not finite or ``size`` is too small.
        ModuleNotFoundError: if xatlas is not installed.
    """
    import xatlas

    if len(triangles) == 0:
        raise ValueError("triangles: expected at least one triangle, got none")
    if not np.isfinite(xyz).all():
        raise ValueError("xyz: expected finite vertices, got NaN or infinity")
    if size < 16:
        raise ValueError(f"size: expected at least 16 texels, got {size}")
    atlas = xatlas.Atlas()
    atlas.add_mesh(np.ascontiguousarray(xyz, np.float32), np.ascontiguousarray(triangles, np.uint32))
    charts, packing = xatlas.ChartOptions(), xatlas.PackOptions()
    packing.resolution = size
    packing.padding = PADDING_TEXELS
    packing.bilinear = True
    atlas.generate(charts, packing)
    source, corners, uv = atlas[0]
    return Atlas(source.astype(np.int64), corners.astype(np.int32), uv.astype(np.float32), int(atlas.chart_count))


def find_texels(atlas: Atlas, size: int) -> Texels:
    """Find the texels of a texture of ``size`` x ``size`` texels whose centres lie in a chart."""
    flat = torch.zeros(len(atlas.uv), 4)
    flat[:, :2] = torch.from_numpy(atlas.uv) * 2 - 1
    flat[:, 3] = 1
    rast, _ = rasterize(flat[None], torch.from_numpy(atlas.triangles), (size, size), grad_db=False)
    index = decode_ids(rast[0, ..., 3]).numpy()
    covered = index >= 0
    u, v = rast[0, ..., 0].numpy()[covered], rast[0, ..., 1].numpy()[covered]
    return Texels(covered, index[covered].astype(np.int64), np.stack([u, v, 1 - u - v], axis=1))
