"""Background opacity term: penalises holes in the background as seen from viewpoints between the training cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from fourd.cameras import Camera
from fourd.raster import render_points
from fourd.training.background import StaticBackground
from fourd.training.config import TrainConfig
from fourd.training.losses.term import RenderedStep
from fourd.training.rendering import NEAR, visible_points

LAYERS = 64
"""Maximum number of points that are composited at each pixel. At any pixel, fewer points than this maximum overlap,
even on a floor viewed at a grazing angle. With too few layers, some transmittance would remain after the last layer,
and training would enlarge the discs until even more discs overlap."""
MAX_LATERAL_OFFSET = 0.15
"""Maximum distance of a viewpoint from the line between two cameras, as a share of the line's length."""
RNG_STREAM = 4
"""Number of the random stream that this loss uses. No other random stream of a run has the same number. The loss draws
its random numbers from ``default_rng([seed, RNG_STREAM, step])``."""


@dataclass(frozen=True, eq=False)
class BackgroundOpacityTerm:
    """Mean squared transmittance of the background from an interpolated viewpoint. The term applies to steps whose
    target is a plate."""

    weight: float
    background: StaticBackground
    config: TrainConfig
    name: str = "closed"

    def applies_to(self, step: RenderedStep) -> bool:
        return step.sample.is_plate

    def value(self, step: RenderedStep) -> Tensor:
        cameras = [self.background.camera(index) for index in self.background.plates]
        rng = np.random.default_rng([self.config.seed, RNG_STREAM, step.number])
        target = self.background.camera(step.sample.target)
        viewer = interpolate_viewpoint(target, cameras, self.config.background.window_px // 2, rng)
        return mean_squared_transmittance(self.background, viewer, self.config.hidden_weight)


def interpolate_viewpoint(camera: Camera, others: Sequence[Camera], side_px: int, rng: np.random.Generator) -> Camera:
    """Move ``camera`` to a random point near the line to another camera, which is chosen at random from ``others``. The
    image of the moved camera is cropped to at most ``side_px`` x ``side_px`` pixels."""
    line = others[int(rng.integers(len(others)))].centre - camera.centre
    offset = rng.normal(size=3)
    offset *= MAX_LATERAL_OFFSET * np.linalg.norm(line) * rng.random() / np.linalg.norm(offset)
    centre = camera.centre + rng.random() * line + offset
    width, height = min(side_px, camera.width), min(side_px, camera.height)
    left, top = rng.integers(camera.width - width + 1), rng.integers(camera.height - height + 1)
    return replace(camera, translation=-camera.rotation @ centre).crop(int(left), int(top), width, height)


def mean_squared_transmittance(background: StaticBackground, viewer: Camera, hidden_weight: float) -> Tensor:
    """Mean of (1 - alpha)^2 over an image of the background. Only the parameters of the background's model get a
    gradient.

    Point positions get no gradient, because the plates determine the positions. Points whose compositing weight is at
    most ``hidden_weight`` at all pixels are skipped; see :func:`visible_points`.
    """
    points = background.points
    rows = visible_points([points], viewer, LAYERS, hidden_weight)[0]
    evaluated = background.model.evaluate(points.xyz[rows], points.spacing[rows], 0.0)
    alpha = render_points(
        evaluated.xyz,
        torch.ones_like(evaluated.radius)[:, None],
        evaluated.radius,
        evaluated.density,
        viewer,
        layers=LAYERS,
        near=NEAR,
    ).alpha
    return (1 - alpha).square().mean()
