"""Creation of an object scene or a full scene."""

from __future__ import annotations

import torch

from fourd.model import PointModel
from fourd.ops.gpu import CPU
from fourd.training.background import StaticBackground
from fourd.training.config import TrainConfig
from fourd.training.scenes.full_scene import FullScene
from fourd.training.scenes.object_scene import ObjectScene
from fourd.training.scenes.scene import TrainingScene
from fourd.training.views import ViewStore


def build_scene(
    config: TrainConfig,
    model: PointModel,
    views: ViewStore,
    background: StaticBackground | None,
    device: torch.device = CPU,
) -> TrainingScene:
    """Return a full scene if there is a background, and an object scene otherwise. Models, static points and the
    tensors of training images are moved to ``device``."""
    model.to(device)
    views.device = device
    if background is not None:
        background.to(device)
    if background is None:
        return ObjectScene(config, model, views)
    return FullScene(config, model, views, background)
