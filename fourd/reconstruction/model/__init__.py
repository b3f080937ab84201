"""The point model: K-Planes, and heads that compute the geometry and the colour of each frame's points from K-Planes
features.

Importing this package does not import torch; the first use of :class:`PointModel` does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fourd.base.lazy import lazy_names

if TYPE_CHECKING:
    from fourd.reconstruction.model.config import ModelConfig, PlanesConfig
    from fourd.reconstruction.model.point_model import PointModel

__all__ = ["ModelConfig", "PlanesConfig", "PointModel"]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "ModelConfig": "config",
        "PlanesConfig": "config",
        "PointModel": "point_model",
    },
)
