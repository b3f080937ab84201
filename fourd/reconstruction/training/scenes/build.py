"""Create an object scene or a full scene."""

from __future__ import annotations

from fourd.reconstruction.model import PointModel
from fourd.reconstruction.training.background import StaticBackground
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.scenes.full_scene import FullScene
from fourd.reconstruction.training.scenes.object_scene import ObjectScene
from fourd.reconstruction.training.scenes.scene import TrainingScene
from fourd.reconstruction.training.views import ViewStore


def build_scene(
    config: TrainConfig, model: PointModel, views: ViewStore, background: StaticBackground | None, near: float
) -> TrainingScene:
    """Return a full scene if there is a background, and an object scene otherwise. The model and the background are
    moved to the device of ``views``. ``near`` is the depth of the near plane in world units."""
    model.to(views.device)
    if background is None:
        return ObjectScene(config, model, views, near)
    background.to(views.device)
    return FullScene(config, model, views, background)
