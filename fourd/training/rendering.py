"""What a step or a picture needs of one part of a scene: what moves, or the background."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from fourd.cameras import Camera
from fourd.model import PointModel
from fourd.model.sources import SourceViews
from fourd.raster import PointRender, point_visibility, render_points
from fourd.training.points.frame_store import FramePoints

NEAR = 0.01


@dataclass(frozen=True)
class Part:
    """A cloud's points that are looked at, evaluated; M of them.

    Attributes:
        points: the whole cloud.
        rows: (M,) which of its points.
        free: the optimised tensors of these, leaves that gather gradients.
        xyz: (M, 3) where they are, a learnt displacement included.
        radius, density: (M,).
        colour: (M, 3).
        displacement: (M, 3), or None where nothing is displaced.
        sources: the views that the colours are from; None where they are from none.
    """

    points: FramePoints
    rows: Tensor
    free: dict[str, Tensor]
    xyz: Tensor
    radius: Tensor
    density: Tensor
    colour: Tensor
    displacement: Tensor | None
    sources: SourceViews | None


def evaluate(
    model: PointModel,
    points: FramePoints,
    rows: Tensor | None,
    time: float,
    viewer: Camera,
    sources: SourceViews | None,
    *,
    shadow_at: float | None = None,
    train_encoder: bool = True,
) -> Part:
    """Evaluate ``rows`` (M,) of a cloud, or all of it, as ``viewer`` sees it at ``time``.

    On a background ``shadow_at`` is the moment whose shadow falls on it; None leaves it as its plates are.
    """
    if rows is None:
        rows = torch.arange(points.xyz.shape[0])
        free, spacing = points.free, points.spacing
    else:
        free = {name: value[rows].requires_grad_() for name, value in points.free.items()}
        spacing = points.spacing[rows]
    xyz = free["xyz"]
    features = model.point_features(xyz, time)
    radius, density = model.geometry(features, spacing)
    displacement = model.displacement(xyz, time)
    placed = xyz if displacement is None else xyz + displacement
    shadow = None if model.shadow is None or shadow_at is None else model.shadow(placed, shadow_at)
    colour = model.colour(
        placed,
        features,
        viewer,
        sources,
        spacing,
        free.get("sh"),
        base=free.get("rgb"),
        shadow=shadow,
        train_encoder=train_encoder,
    )
    return Part(points, rows, free, placed, radius, density, colour, displacement, sources)


def composite(parts: Sequence[Part], viewer: Camera, layers: int, background: Tensor | None = None) -> PointRender:
    """All parts in one peel, so that they hide each other; the last feature says how much is of the first part."""
    first = [torch.ones_like(part.radius) if k == 0 else torch.zeros_like(part.radius) for k, part in enumerate(parts)]
    features = torch.cat([torch.cat([part.colour, of[:, None]], 1) for part, of in zip(parts, first, strict=True)])
    return render_points(
        torch.cat([part.xyz for part in parts]),
        features,
        torch.cat([part.radius for part in parts]),
        torch.cat([part.density for part in parts]),
        viewer,
        layers=layers,
        near=NEAR,
        background=background,
    )


def visible_points(clouds: Sequence[FramePoints], viewer: Camera, layers: int, least: float) -> list[Tensor]:
    """Of each cloud, the points whose largest weight in the view is above ``least``; all of them where that is 0."""
    if least == 0:
        return [torch.arange(cloud.xyz.shape[0]) for cloud in clouds]
    weight = point_visibility(
        torch.cat([cloud.xyz for cloud in clouds]),
        torch.cat([cloud.radius for cloud in clouds]),
        torch.cat([cloud.density for cloud in clouds]),
        viewer,
        layers=layers,
        near=NEAR,
    )
    parts = weight.split([cloud.xyz.shape[0] for cloud in clouds])
    return [select_heaviest(part, least) for part in parts]


ROWS = 1024


def select_heaviest(weight: Tensor, least: float) -> Tensor:
    """Ascending indices of the weights (N,) above ``least``, and of the next lower ones up to whole ROWS.

    Tensors of a step then come in few sizes, and fit into the memory that the steps before it freed.
    """
    count = int((weight > least).sum())
    rounded = min(weight.shape[0], -(-count // ROWS) * ROWS)
    return weight.topk(rounded, sorted=False).indices.sort().values
