"""The point model: K-Planes, and heads that compute the geometry and the colour of each frame's points from K-Planes
features.

Importing this package does not import torch; the first use of :class:`PointModel` does.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fourd.reconstruction.model.config import ModelConfig, PlanesConfig
    from fourd.reconstruction.model.point_model import PointModel

_MODULES: dict[str, str] = {
    "ModelConfig": "config",
    "PlanesConfig": "config",
    "PointModel": "point_model",
}
"""Maps each public name to the module of this package that defines it."""

__all__ = ["ModelConfig", "PlanesConfig", "PointModel"]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
