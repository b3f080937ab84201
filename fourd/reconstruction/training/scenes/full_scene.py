"""Full scenes: a foreground given by the mattes, in front of a static background given by the clean plates."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.cameras import Camera, SelectedViews
from fourd.reconstruction.model import PointModel
from fourd.reconstruction.model.training_step import evaluate_in_view
from fourd.reconstruction.training.background import StaticBackground
from fourd.reconstruction.training.cameras.refinement import Refinement
from fourd.reconstruction.training.cameras.rig import Rig
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.losses.lpips import LPIPS
from fourd.reconstruction.training.losses.term import LossTerm
from fourd.reconstruction.training.losses.terms import full_scene_terms
from fourd.reconstruction.training.memory import FULL_RESIDENT_BYTES
from fourd.reconstruction.training.points.densification import densify, unobserved_points
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.points.near_plane import is_before_near
from fourd.reconstruction.training.rendering import RenderablePoints, visible_points
from fourd.reconstruction.training.scenes.object_scene import ObjectScene
from fourd.reconstruction.training.scenes.scene import OptimizedPoints, PreparedStep, Target
from fourd.reconstruction.training.schedule import StepSample
from fourd.reconstruction.training.views import View, ViewStore

RNG_STREAM = 3
"""Number that identifies densification's random stream; no other random stream of a run has it. Densification draws its
random numbers from ``default_rng([seed, RNG_STREAM, frame, age])``."""
BACKGROUND_SEED = 2**31
"""Number that replaces the frame index in the seed of the background's densification. It is larger than every frame
index."""


class FullScene:
    """A scene with a foreground and a static background; see
    :class:`fourd.reconstruction.training.scenes.scene.TrainingScene`.

    A step renders either a frame or a clean plate. If ``config.background.joint`` is true, a step on a frame renders
    the foreground together with the background. Otherwise, it renders and trains only the foreground.
    """

    resident_bytes = FULL_RESIDENT_BYTES

    def __init__(self, config: TrainConfig, model: PointModel, views: ViewStore, background: StaticBackground) -> None:
        self.config = config
        self.views = views
        self.background = background
        self.foreground = ObjectScene(config, model, views, background.near)
        self.models: Mapping[str, PointModel] = {**self.foreground.models, "background": background.model}

    @property
    def near(self) -> float:
        return self.background.near

    @property
    def static_clouds(self) -> Mapping[str, FramePoints]:
        return {"background": self.background.points}

    def loss_terms(self, lpips: LPIPS | None, refinement: Refinement | None) -> tuple[LossTerm, ...]:
        return self.foreground.loss_terms(lpips, refinement) + full_scene_terms(self.config, self.background)

    def set_rig(self, rig: Rig) -> None:
        self.foreground.set_rig(rig)
        self.background.rig = rig

    def prepare(self, points: FramePoints, sample: StepSample, threads: int = 0) -> PreparedStep:
        if sample.is_plate:
            return PreparedStep(self._plate_target(sample))
        if not self.config.background.joint:
            return self.foreground.prepare(points, sample, threads)
        return PreparedStep(self._frame_target(sample), sources=self.foreground.sources(points, sample, threads))

    def _frame_target(self, sample: StepSample) -> Target:
        margin_px = int(sample.position[0] * (self.config.background.margin_px + 1))
        view = self.views.widened(sample.target, sample.frame, margin_px)
        rgb = torch.tensor(view.rgb, device=self.views.device).float() / 255
        matte = torch.tensor(view.matte, device=self.views.device).float() / 255
        return Target(view.camera, rgb, matte, torch.ones_like(matte), fills_picture=True)

    def evaluate_step(
        self, points: FramePoints, time: float, sample: StepSample, prepared: PreparedStep, step: int
    ) -> list[OptimizedPoints]:
        if not (sample.is_plate or self.config.background.joint):
            return self.foreground.evaluate_step(points, time, sample, prepared, step)
        camera = prepared.target.camera
        clouds = [] if sample.is_plate else [points]
        clouds.append(self.background.points)
        rows = visible_points(clouds, camera, self.config.layers, self.near, self.config.hidden_weight)
        evaluated = []
        if not sample.is_plate:
            evaluated.append(self.foreground.evaluate_visible(points, rows[0], time, prepared, step))
        evaluated.append(self._evaluate_background(rows[-1], time, sample, camera, step))
        return evaluated

    def xyz_rate(self, points: OptimizedPoints, factor: float) -> Tensor:
        if points.cloud is not self.background.points:
            return self.foreground.xyz_rate(points, factor)
        return self.config.background.xyz_rate * factor * points.cloud.spacing.index_select(0, points.rows)[:, None]

    def least_depth(self, points: OptimizedPoints) -> float:
        return self.background.static_near if points.cloud is self.background.points else self.near

    def finish_step(self) -> None:
        self.background.count_step()

    def densify(self, points: FramePoints, sample: StepSample, spent: float) -> None:
        config = self.config.densify
        if not config.on or spent > config.until:
            return
        seed = [self.config.seed, RNG_STREAM]
        with torch.no_grad():
            if not sample.is_plate and int(points.age) % config.frame_every == 0:
                unobserved = unobserved_points(points, config.frame_every)
                densify(points, config, unobserved, [*seed, sample.frame, int(points.age)])
            static = self.background.points
            is_in_picture = sample.is_plate or self.config.background.joint
            if is_in_picture and int(static.age) % config.background_every == 0:
                before = is_before_near(static.xyz.cpu().numpy(), self.background.cameras, self.background.static_near)
                hidden = self.background.hidden_points() | torch.from_numpy(before).to(static.xyz.device)
                densify(static, config, hidden, [*seed, BACKGROUND_SEED, int(static.age)])
                self.background.clear_cache()

    def clear_caches(self) -> None:
        self.background.clear_cache()

    def evaluate_frame(
        self, points: FramePoints, frame: int, camera: Camera, sources: SelectedViews
    ) -> list[RenderablePoints]:
        foreground = self.foreground.evaluate_frame(points, frame, camera, sources)
        return [*foreground, self.evaluate_background(camera, sources, self.views.capture.time(frame))]

    def evaluate_background(
        self, camera: Camera, sources: SelectedViews, shadow_time: float | None = None
    ) -> RenderablePoints:
        """Evaluate all background points with the shadows at the time ``shadow_time``, or without shadows if it is
        None."""
        model, points = self.background.model, self.background.points
        with torch.no_grad():
            plates = None
            if model.config.appearance != "sh":
                plates = self.background.sources(sources.indices).weighted(sources.weights)
            evaluated = model.evaluate(points.xyz, points.spacing, 0.0, rgb=points.parameters.get("rgb"))
            shadow = None
            if model.shadow is not None and shadow_time is not None:
                shadow = model.shadow(evaluated.xyz, shadow_time)
            colour = model.colour(evaluated, camera, plates, shadow=shadow, is_training=False)
            return RenderablePoints.of(evaluated, colour)

    def reference_picture(self, view: View) -> NDArray[np.float32]:
        return (view.rgb / np.float32(255)).astype(np.float32)

    def _plate_target(self, sample: StepSample) -> Target:
        plate = self.background.plates[sample.target]
        camera = self.background.camera(sample.target)
        window = place_window(camera, self.config.background.window_px, sample.position[1:])
        left, top, width, height = window
        rows, columns = slice(top, top + height), slice(left, left + width)
        rgb = torch.tensor(plate.rgb[rows, columns], device=self.views.device).float() / 255
        seen = torch.tensor(plate.seen[rows, columns], device=self.views.device).float()
        return Target(camera.crop(*window), rgb * seen[..., None], None, seen, fills_picture=True)

    def _evaluate_background(
        self, rows: Tensor, time: float, sample: StepSample, camera: Camera, step: int
    ) -> OptimizedPoints:
        model, points = self.background.model, self.background.points
        sources = None
        if self.config.model.appearance != "sh":
            train_encoder = sample.is_plate and step % self.config.background.encoder_every == 0
            sources = self.background.sources(sample.sources, train_encoder=train_encoder)
            sources = sources.weighted(sample.source_weights)
        leaves = {name: value.index_select(0, rows).requires_grad_() for name, value in points.parameters.items()}
        # The background has no residual field, so shadows are computed at the points' own positions.
        shadow = None if model.shadow is None or sample.is_plate else model.shadow(leaves["xyz"], time)
        evaluated, colour = evaluate_in_view(
            model,
            leaves["xyz"],
            points.spacing.index_select(0, rows),
            0.0,
            camera,
            sources,
            rgb=leaves.get("rgb"),
            shadow=shadow,
        )
        return OptimizedPoints(points, rows, leaves, evaluated, colour, sources)


def place_window(camera: Camera, side_px: int, position: tuple[float, ...]) -> tuple[int, int, int, int]:
    """Place a window in the image, and return it as (left, top, width, height). The window is a square of side
    ``side_px``. If the image is narrower than that, the window has the image's width instead; the same applies to the
    height.

    ``position`` (x, y) in [0, 1) is the window's centre as a fraction of the image size. A window that extends beyond
    the image is shifted into it. As a result, many windows contain an image corner, whereas almost none would if
    windows were placed uniformly inside the image.
    """
    width, height = min(side_px, camera.width), min(side_px, camera.height)
    left = np.clip(round(position[0] * camera.width - width / 2), 0, camera.width - width)
    top = np.clip(round(position[1] * camera.height - height / 2), 0, camera.height - height)
    return int(left), int(top), width, height
