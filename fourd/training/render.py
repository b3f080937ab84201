"""Rendering a trained frame from any camera, without gradients: for validation, evaluation and pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from fourd.cameras import Camera, nearest_views
from fourd.model import PointModel
from fourd.raster.arrays import render_points_numpy
from fourd.training.data import ViewStore
from fourd.training.frames import FramePoints
from fourd.training.step import NEAR, with_depth


@dataclass(frozen=True)
class Picture:
    """A rendered view: rgb (H, W, 3) on black, alpha (H, W) and depth (H, W), all float32."""

    rgb: NDArray[np.float32]
    alpha: NDArray[np.float32]
    depth: NDArray[np.float32]


class Renderer:
    """Renders frames of a model; source views are the nearest of ``training`` cameras."""

    def __init__(self, model: PointModel, views: ViewStore, training: list[int], focus: NDArray[np.float64]) -> None:
        self.model = model
        self.views = views
        self.training = training
        self.focus = focus

    def render(
        self, points: FramePoints, frame: int, camera: Camera, layers: int, exclude: int | None = None
    ) -> Picture:
        """Render a frame (index into the selection) from ``camera`` with K = ``layers``.

        ``exclude`` names a source camera that must not be used, so that a training view can be
        judged without copying from itself.
        """
        with torch.no_grad():
            time = self.views.capture.time(frame)
            xyz, radius, density, colour = self._shaded(points, frame, time, camera, exclude)
            rgb, alpha, depth = render_points_numpy(
                xyz.numpy(), colour.numpy(), radius.numpy(), density.numpy(), camera, layers=layers, near=NEAR
            )
        return Picture(np.clip(rgb, 0, 1), alpha, depth)

    def _shaded(
        self, points: FramePoints, frame: int, time: float, camera: Camera, exclude: int | None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
        features = self.model.point_features(points.xyz, time)
        radius, density = self.model.geometry(features)
        displacement = self.model.displacement(points.xyz, time)
        xyz = points.xyz if displacement is None else points.xyz + displacement
        sources = None
        if self.model.config.appearance != "sh":
            candidates = [index for index in self.training if index != exclude]
            cameras = [self.views.capture.cameras[index] for index in candidates]
            nearest = nearest_views(camera, cameras, self.model.config.neighbours, self.focus)
            chosen = self.views.sources([candidates[i] for i in nearest], frame)
            sources = with_depth(chosen, replace(points, radius=radius, density=density), self.model.config.occlusion)
        colour = self.model.colour(xyz, features, camera, sources, points.free.get("sh"))
        return xyz, radius, density, colour
