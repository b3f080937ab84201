"""Composite points with the radii, densities and colours that the model computes, and select the points that are
visible in a view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.reconstruction.model.point_model import EvaluatedPoints
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.rendering import PointRender, point_visibility, render_points

COUNT_STEP = 1024
"""The number of visible points is rounded up to a multiple of this number, so that tensors have few different sizes and
fit into memory that earlier steps have freed."""


@dataclass(frozen=True)
class RenderablePoints:
    """The data of N points that a renderer needs.

    Attributes:
        xyz: (N, 3) positions in world units.
        radius: (N,) radii in world units.
        density: (N,) densities in (0, 1).
        colour: (N, 3) RGB as seen from one viewing camera.
    """

    xyz: Tensor
    radius: Tensor
    density: Tensor
    colour: Tensor

    @classmethod
    def of(cls, points: EvaluatedPoints, colour: Tensor) -> RenderablePoints:
        """Combine evaluated points with their colours (N, 3)."""
        return cls(points.xyz, points.radius, points.density, colour)


def concatenate(clouds: Sequence[RenderablePoints]) -> RenderablePoints:
    """Concatenate clouds into one cloud, in the given order."""
    names = ("xyz", "radius", "density", "colour")
    return RenderablePoints(*(torch.cat([getattr(cloud, name) for cloud in clouds]) for name in names))


def _joined(tensors: Sequence[Tensor]) -> Tensor:
    """Concatenate tensors along the first axis. A single tensor is not copied."""
    return tensors[0] if len(tensors) == 1 else torch.cat(list(tensors))


def composite(
    clouds: Sequence[RenderablePoints], viewer: Camera, layers: int, near: float, background: Tensor | None = None
) -> PointRender:
    """Render all clouds together, so that they occlude each other. ``near`` is the depth of the near plane in world
    units.

    The result has features (H, W, 4): the first three channels are the colour, and the last is the contribution of the
    first cloud to alpha.
    """
    ones, zeros = torch.ones_like, torch.zeros_like
    is_first = [ones(cloud.radius) if k == 0 else zeros(cloud.radius) for k, cloud in enumerate(clouds)]
    features = [torch.cat([cloud.colour, own[:, None]], 1) for cloud, own in zip(clouds, is_first, strict=True)]
    return render_points(
        _joined([cloud.xyz for cloud in clouds]),
        _joined(features),
        _joined([cloud.radius for cloud in clouds]),
        _joined([cloud.density for cloud in clouds]),
        viewer,
        layers=layers,
        near=near,
        background=background,
    )


def composite_samples(
    clouds: Sequence[RenderablePoints], viewer: Camera, layers: int, near: float, samples: int
) -> tuple[Tensor, Tensor]:
    """Render all clouds together, with ``samples`` x ``samples`` evenly spaced samples in each pixel.

    Returns:
        features (samples * H, samples * W, 4) as in :func:`composite`, and alpha (samples * H, samples * W).
    """
    render = composite(clouds, viewer if samples == 1 else viewer.rescale(samples), layers, near)
    return render.features, render.alpha


def visible_points(
    clouds: Sequence[FramePoints], viewer: Camera, layers: int, near: float, min_weight: float, threads: int = 0
) -> list[Tensor]:
    """Return the indices of the visible points of each cloud. A point is visible if its compositing weight exceeds
    ``min_weight`` at one or more pixels of the view. As in :func:`select_heaviest`, the number of indices is rounded up
    to a multiple of COUNT_STEP.

    Clouds occlude each other. If ``min_weight`` is 0, all points are returned. ``threads`` is the number of CPU
    threads, or 0 for the default.
    """
    if min_weight == 0:
        return [torch.arange(cloud.xyz.shape[0], device=cloud.xyz.device) for cloud in clouds]
    weight = point_visibility(
        _joined([cloud.xyz for cloud in clouds]),
        _joined([cloud.radius for cloud in clouds]),
        _joined([cloud.density for cloud in clouds]),
        viewer,
        layers=layers,
        near=near,
        threads=threads,
    )
    weights = weight.split([cloud.xyz.shape[0] for cloud in clouds])
    return [select_heaviest(each, min_weight) for each in weights]


def select_heaviest(weight: Tensor, min_weight: float) -> Tensor:
    """Return the ascending indices of the weights (N,) that exceed ``min_weight``.

    The indices of the largest other weights are added until the number of indices is a multiple of COUNT_STEP.
    """
    count = int((weight > min_weight).sum())
    rounded = min(weight.shape[0], -(-count // COUNT_STEP) * COUNT_STEP)
    heaviest = weight.topk(rounded, sorted=False).indices
    if weight.device.type != "cpu":
        return heaviest.sort().values
    # torch's sort takes ten times as long.
    is_chosen = np.zeros(weight.shape[0], bool)
    is_chosen[heaviest.numpy()] = True
    return torch.from_numpy(np.flatnonzero(is_chosen))
