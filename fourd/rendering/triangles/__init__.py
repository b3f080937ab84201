"""Differentiable rasterization of triangles: the public API.

Importing this package does not import torch; the first use of one of the public names does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fourd.base.lazy import lazy_names

if TYPE_CHECKING:
    from fourd.rendering.triangles.antialiasing import Topology, antialias, antialias_construct_topology
    from fourd.rendering.triangles.clipping import clip_matrix
    from fourd.rendering.triangles.gradient_estimates import estimate_gradient
    from fourd.rendering.triangles.interpolation import interpolate
    from fourd.rendering.triangles.peeling import DepthPeeler
    from fourd.rendering.triangles.rasterization import rasterize
    from fourd.rendering.triangles.soft import rasterize_soft
    from fourd.rendering.triangles.splatting import TriangleRender, splat_triangles
    from fourd.rendering.triangles.textures import Mip, texture, texture_construct_mip
    from fourd.rendering.triangles.visibility_edges import edge_gradients

__all__ = [
    "DepthPeeler",
    "Mip",
    "Topology",
    "TriangleRender",
    "antialias",
    "antialias_construct_topology",
    "clip_matrix",
    "edge_gradients",
    "estimate_gradient",
    "interpolate",
    "rasterize",
    "rasterize_soft",
    "splat_triangles",
    "texture",
    "texture_construct_mip",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "DepthPeeler": "peeling",
        "Mip": "textures",
        "Topology": "antialiasing",
        "TriangleRender": "splatting",
        "antialias": "antialiasing",
        "antialias_construct_topology": "antialiasing",
        "clip_matrix": "clipping",
        "edge_gradients": "visibility_edges",
        "estimate_gradient": "gradient_estimates",
        "interpolate": "interpolation",
        "rasterize": "rasterization",
        "rasterize_soft": "soft",
        "splat_triangles": "splatting",
        "texture": "textures",
        "texture_construct_mip": "textures",
    },
)
