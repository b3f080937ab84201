"""Background opacity term: penalises holes in the background as seen from viewpoints between the training cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.reconstruction.training.background import StaticBackground
from fourd.reconstruction.training.config import TrainConfig
from fourd.reconstruction.training.losses.term import RenderedStep
from fourd.reconstruction.training.rendering import visible_points
from fourd.rendering import render_points

LAYERS = 64
"""Maximum number of points that are composited at each pixel. It is larger than the number of points that overlap at
any pixel, even on a floor viewed at a grazing angle. If the maximum were too small, some transmittance would remain
after the last layer, and training would enlarge the discs, so that even more of them overlap."""
MAX_LATERAL_OFFSET = 0.15
"""Maximum distance of a viewpoint from the line between two cameras, as a fraction of the line's length."""
RNG_STREAM = 4
"""Number that identifies this loss's random stream; no other random stream of a run has it. The loss draws its random
numbers from ``default_rng([seed, RNG_STREAM, step])``."""


@dataclass(frozen=True, eq=False)
class BackgroundOpacityTerm:
    """Mean squared transmittance of the background from an interpolated viewpoint. Applies to steps whose target is a
    clean plate."""

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
    """Move ``camera`` to a random point near the line segment between its centre and the centre of a camera that is
    chosen at random from ``others``. The moved camera's image is cropped to at most ``side_px`` x ``side_px`` pixels.
    """
    line = others[int(rng.integers(len(others)))].centre - camera.centre
    offset = rng.normal(size=3)
    offset *= MAX_LATERAL_OFFSET * np.linalg.norm(line) * rng.random() / np.linalg.norm(offset)
    centre = camera.centre + rng.random() * line + offset
    width, height = min(side_px, camera.width), min(side_px, camera.height)
    left, top = rng.integers(camera.width - width + 1), rng.integers(camera.height - height + 1)
    return replace(camera, translation=-camera.rotation @ centre).crop(int(left), int(top), width, height)


def mean_squared_transmittance(background: StaticBackground, viewer: Camera, hidden_weight: float) -> Tensor:
    """Compute the mean of (1 - alpha)^2 over an image of the background. Only the parameters of the background's model
    get a gradient.

    Point positions get no gradient, because the clean plates determine them. Points whose compositing weight is at most
    ``hidden_weight`` at all pixels are skipped; see :func:`visible_points`.
    """
    points = background.points
    rows = visible_points([points], viewer, LAYERS, background.near, hidden_weight)[0]
    evaluated = background.model.evaluate(points.xyz[rows], points.spacing[rows], 0.0)
    alpha = render_points(
        evaluated.xyz,
        torch.ones_like(evaluated.radius)[:, None],
        evaluated.radius,
        evaluated.density,
        viewer,
        layers=LAYERS,
        near=background.near,
    ).alpha
    return (1 - alpha).square().mean()
