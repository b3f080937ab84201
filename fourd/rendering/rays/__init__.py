"""Differentiable ray tracing of triangle meshes: the public API.

Importing this package does not import torch; the first use of one of the public names does.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fourd.rendering.rays.bvh import Bvh
    from fourd.rendering.rays.splatting import RaySplats, splat_along_rays
    from fourd.rendering.rays.tracing import Hits, occluded, trace, visibility

_MODULES: dict[str, str] = {
    "Bvh": "bvh",
    "Hits": "tracing",
    "RaySplats": "splatting",
    "occluded": "tracing",
    "splat_along_rays": "splatting",
    "trace": "tracing",
    "visibility": "tracing",
}
"""Maps each public name to the module of this package that defines it."""

__all__ = ["Bvh", "Hits", "RaySplats", "occluded", "splat_along_rays", "trace", "visibility"]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
