"""Rendering a trained frame from any camera, without gradients: for validation, evaluation and pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from fourd.cameras import Camera, nearest_views
from fourd.model import PointModel
from fourd.training.background import StaticBackground
from fourd.training.points.frame_store import FramePoints
from fourd.training.rendering import Part, composite, evaluate
from fourd.training.step import with_depth
from fourd.training.views import ViewStore


@dataclass(frozen=True)
class RenderedView:
    """A rendered view, all float32.

    Attributes:
        rgb: (H, W, 3) on black.
        alpha, depth: (H, W).
        moving: (H, W) how much of the light is from what moves: alpha, where there is no background.
    """

    rgb: NDArray[np.float32]
    alpha: NDArray[np.float32]
    depth: NDArray[np.float32]
    moving: NDArray[np.float32]


class Renderer:
    """Renders frames of a model; source views are the nearest of ``training`` cameras."""

    def __init__(
        self,
        model: PointModel,
        views: ViewStore,
        training: list[int],
        focus: NDArray[np.float64],
        background: StaticBackground | None = None,
    ) -> None:
        self.model = model
        self.views = views
        self.training = training
        self.focus = focus
        self.background = background

    def render(
        self, points: FramePoints, frame: int, camera: Camera, layers: int, exclude: int | None = None
    ) -> RenderedView:
        """Render a frame (index into the selection) from ``camera`` with K = ``layers``.

        ``exclude`` names a source camera that must not be used, so that a training view can be
        judged without copying from itself.
        """
        return picture_of(self.parts(points, frame, camera, exclude), camera, layers)

    def parts(self, points: FramePoints, frame: int, camera: Camera, exclude: int | None = None) -> list[Part]:
        """What a frame shows to ``camera``, evaluated; arguments as :meth:`render`."""
        with torch.no_grad():
            parts = [self._moving(points, frame, camera, exclude)]
            if self.background is not None:
                parts.append(self._static(self.background, camera, exclude, self.views.capture.time(frame)))
            return parts

    def render_background(self, camera: Camera, layers: int, exclude: int | None = None) -> RenderedView:
        """The background alone, without shadows, of which a full scene has one."""
        assert self.background is not None, "an object scene has no background"
        with torch.no_grad():
            parts = [self._static(self.background, camera, exclude)]
        return picture_of(parts, camera, layers)

    def _moving(self, points: FramePoints, frame: int, camera: Camera, exclude: int | None) -> Part:
        time = self.views.capture.time(frame)
        features = self.model.point_features(points.xyz, time)
        radius, density = self.model.geometry(features, points.spacing)
        sources = None
        if self.model.config.appearance != "sh":
            chosen = self.views.sources(self._nearest(camera, exclude), frame)
            displacement = self.model.displacement(points.xyz, time)
            placed = points.xyz if displacement is None else points.xyz + displacement
            seen = replace(points, radius=radius, density=density, free={**points.free, "xyz": placed})
            sources = with_depth(chosen, seen, self.model.config.occlusion)
        return evaluate(self.model, points, None, time, camera, sources)

    def _static(
        self, background: StaticBackground, camera: Camera, exclude: int | None, shadow_at: float | None = None
    ) -> Part:
        plates = None
        if background.model.config.appearance != "sh":
            plates = background.sources(self._nearest(camera, exclude))
        return evaluate(background.model, background.points, None, 0.0, camera, plates, shadow_at=shadow_at)

    def _nearest(self, camera: Camera, exclude: int | None) -> list[int]:
        candidates = [index for index in self.training if index != exclude]
        cameras = [self.views.rig.cameras[index] for index in candidates]
        nearest = nearest_views(camera, cameras, self.model.config.neighbours, self.focus)
        return [candidates[i] for i in nearest]


def picture_of(parts: list[Part], camera: Camera, layers: int) -> RenderedView:
    """What was evaluated for a camera, as it or one near it sees it."""
    with torch.no_grad():
        render = composite(parts, camera, layers)
    rgb, moving = render.features[..., :3].clamp(0, 1), render.features[..., 3]
    return RenderedView(rgb.numpy(), render.alpha.numpy(), render.depth.numpy(), moving.numpy())
