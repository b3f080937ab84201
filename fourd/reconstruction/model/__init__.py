"""The point model: K-Planes, and heads that compute the geometry and the colour of each frame's points from K-Planes
features."""

from fourd.reconstruction.model.config import ModelConfig, PlanesConfig
from fourd.reconstruction.model.point_model import PointModel

__all__ = ["ModelConfig", "PlanesConfig", "PointModel"]
