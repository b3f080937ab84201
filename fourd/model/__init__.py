"""The model: K-Planes features, a geometry head and an appearance head over per-frame points."""

from fourd.model.config import ModelConfig, PlanesConfig
from fourd.model.point_model import PointModel

__all__ = ["ModelConfig", "PlanesConfig", "PointModel"]
