"""Creation of a scene of either kind."""

from __future__ import annotations

from fourd.model import PointModel
from fourd.training.background import StaticBackground
from fourd.training.config import TrainConfig
from fourd.training.scenes.full_scene import FullScene
from fourd.training.scenes.object_scene import ObjectScene
from fourd.training.scenes.scene import TrainingScene
from fourd.training.views import ViewStore


def build_scene(
    config: TrainConfig, model: PointModel, views: ViewStore, background: StaticBackground | None
) -> TrainingScene:
    """A full scene if there is a background, otherwise an object."""
    if background is None:
        return ObjectScene(config, model, views)
    return FullScene(config, model, views, background)
