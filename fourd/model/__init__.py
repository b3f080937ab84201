"""The point model: K-Planes features, a geometry head and appearance heads over the points of each frame."""

from fourd.model.config import ModelConfig, PlanesConfig
from fourd.model.point_model import PointModel

__all__ = ["ModelConfig", "PlanesConfig", "PointModel"]
