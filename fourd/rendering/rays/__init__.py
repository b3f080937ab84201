"""Differentiable ray tracing of triangle meshes: the public API.

Importing this package does not import torch; the first use of one of the public names does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fourd.base.lazy import lazy_names

if TYPE_CHECKING:
    from fourd.rendering.rays.bvh import Bvh
    from fourd.rendering.rays.splatting import RaySplats, splat_along_rays
    from fourd.rendering.rays.tracing import Hits, occluded, trace, visibility

__all__ = ["Bvh", "Hits", "RaySplats", "occluded", "splat_along_rays", "trace", "visibility"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "Bvh": "bvh",
        "Hits": "tracing",
        "RaySplats": "splatting",
        "occluded": "tracing",
        "splat_along_rays": "splatting",
        "trace": "tracing",
        "visibility": "tracing",
    },
)
