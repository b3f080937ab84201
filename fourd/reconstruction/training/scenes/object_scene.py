"""Object scenes, which contain only the foreground that the mattes cover."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.cameras import Camera, SelectedViews
from fourd.reconstruction.model import PointModel
from fourd.reconstruction.model.sources import SourceViews
from fourd.reconstruction.model.training_step import evaluate_in_view
from fourd.reconstruction.training.background import StaticBackground
from fourd.reconstruction.training.cameras.refinement import Refinement
from fourd.reconstruction.training.cameras.rig import Rig
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.losses.lpips import LPIPS
from fourd.reconstruction.training.losses.term import LossTerm
from fourd.reconstruction.training.losses.terms import common_terms
from fourd.reconstruction.training.memory import RESIDENT_BYTES
from fourd.reconstruction.training.occlusion import with_surface_depth
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.rendering import RenderablePoints, visible_points
from fourd.reconstruction.training.scenes.scene import OptimizedPoints, PreparedStep, Target
from fourd.reconstruction.training.schedule import StepSample
from fourd.reconstruction.training.views import View, ViewStore


class ObjectScene:
    """A scene that contains only the foreground; see
    :class:`fourd.reconstruction.training.scenes.scene.TrainingScene`."""

    background: StaticBackground | None = None
    resident_bytes = RESIDENT_BYTES

    def __init__(self, config: TrainConfig, model: PointModel, views: ViewStore, near: float) -> None:
        self.config = config
        self.model = model
        self.views = views
        self.near = near
        self.models: Mapping[str, PointModel] = {"model": model}

    @property
    def static_clouds(self) -> Mapping[str, FramePoints]:
        return {}

    def loss_terms(self, lpips: LPIPS | None, refinement: Refinement | None) -> tuple[LossTerm, ...]:
        return common_terms(self.config, self.model.spacing, lpips, refinement)

    def set_rig(self, rig: Rig) -> None:
        self.views.rig = rig

    def target(self, sample: StepSample) -> Target:
        """Return the ground-truth image of a step: the matte's content on black."""
        view = self.views.view(sample.target, sample.frame)
        rgb, matte = view.premultiplied(self.views.device)
        return Target(view.camera, rgb, matte, matte, fills_picture=False)

    def prepare(self, points: FramePoints, sample: StepSample, threads: int = 0) -> PreparedStep:
        target, config = self.target(sample), self.config
        rows = visible_points([points], target.camera, config.layers, self.near, config.hidden_weight, threads)[0]
        return PreparedStep(target, rows, self.sources(points, sample, threads))

    def sources(self, points: FramePoints, sample: StepSample, threads: int = 0) -> SourceViews | None:
        """Return the source views of a step with the depths of its points, or None if the model has no image-based
        colour."""
        if self.config.model.appearance == "sh":
            return None
        views = self.views.sources(sample.sources, sample.frame).weighted(sample.source_weights)
        return with_surface_depth(views, points, self.config.model.occlusion, self.near, threads)

    def evaluate_step(
        self, points: FramePoints, time: float, sample: StepSample, prepared: PreparedStep, step: int
    ) -> list[OptimizedPoints]:
        assert prepared.rows is not None, "no other cloud occludes the points of an object scene"
        return [self.evaluate_visible(points, prepared.rows, time, prepared, step)]

    def evaluate_visible(
        self, points: FramePoints, rows: Tensor, time: float, prepared: PreparedStep, step: int
    ) -> OptimizedPoints:
        """Evaluate the points with the indices ``rows`` (M,). The result is differentiable."""
        sources = prepared.sources
        leaves = {name: value.index_select(0, rows).requires_grad_() for name, value in points.parameters.items()}
        evaluated, colour = evaluate_in_view(
            self.model,
            leaves["xyz"],
            points.spacing.index_select(0, rows),
            time,
            prepared.target.camera,
            sources,
            explicit_sh=leaves.get("sh"),
            rgb=leaves.get("rgb"),
            train_encoder=step % self.config.encoder_every == 0,
        )
        return OptimizedPoints(points, rows, leaves, evaluated, colour, sources)

    def xyz_rate(self, points: OptimizedPoints, factor: float) -> Tensor:
        rates = self.config.rates
        rate = rates.xyz_spacings * factor * points.cloud.spacing.index_select(0, points.rows)
        if rates.xyz_halving_updates:
            steps = points.cloud.optimizer.steps.index_select(0, points.rows)
            rate = rate / (1 + steps / rates.xyz_halving_updates)
        return rate[:, None]

    def least_depth(self, points: OptimizedPoints) -> float:
        return self.near

    def finish_step(self) -> None:
        pass

    def densify(self, points: FramePoints, sample: StepSample, spent: float) -> None:
        """Do nothing: the points of an object scene are neither split nor removed."""

    def clear_caches(self) -> None:
        pass

    def evaluate_frame(
        self, points: FramePoints, frame: int, camera: Camera, sources: SelectedViews
    ) -> list[RenderablePoints]:
        with torch.no_grad():
            evaluated = self.model.evaluate(
                points.xyz,
                points.spacing,
                self.views.capture.time(frame),
                explicit_sh=points.parameters.get("sh"),
                rgb=points.parameters.get("rgb"),
            )
            views: SourceViews | None = None
            if self.model.config.appearance != "sh":
                selected = self.views.sources(sources.indices, frame).weighted(sources.weights)
                views = with_surface_depth(selected, evaluated, self.model.config.occlusion, self.near)
            return [RenderablePoints.of(evaluated, self.model.colour(evaluated, camera, views, is_training=False))]

    def reference_picture(self, view: View) -> NDArray[np.float32]:
        return view.premultiplied()[0].numpy()
