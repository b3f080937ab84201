"""More points where the error is: points that pull hardest are halved, points that never show give way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from fourd.training.config import DensifyConfig
from fourd.training.points.frame_store import FramePoints
from fourd.training.points.spacing import spacings

NEAREST = 3
"""A new point lies between its parent and one of so many neighbours: on the surface, that is, more or less."""


@dataclass(frozen=True)
class Densified:
    """What a round did to a cloud: how many points came, and how many went."""

    born: int
    gone: int


def accumulate_gradient_magnitudes(points: FramePoints, rows: Tensor, gradient: Tensor) -> None:
    """Keep what a step's gradient of the positions (M, 3) says of ``rows`` (M,): how hard they pull, if they show.

    The measure is the change of the loss for a step as long as the point's spacing: without a unit, for near points
    and far ones (after the view-space gradient of Kerbl et al. 2023, sec. 5.2).
    """
    pull = gradient.norm(dim=1) * points.spacing[rows]
    points.error[rows] += pull
    points.shown[rows] += (pull > 0).float()
    points.age += 1


def unobserved_points(points: FramePoints, patience: int) -> Tensor:
    """(N,) bool, which points have had ``patience`` steps of the cloud to show in and did in none."""
    return (points.shown == 0) & (points.age - points.born >= patience)


def densify(points: FramePoints, config: DensifyConfig, idle: Tensor, seed: list[int]) -> Densified:
    """Halve the points whose mean pull is largest, at most ``config.share`` of them, into two; drop the idle.

    The count stays below ``config.growth`` times what it was first. The cloud is changed in place; new points have
    the means of their two parents, no moments and no history.

    Args:
        idle: (N,) bool, points that show nowhere; they go, but for those that last.
        seed: of the choice among neighbours.
    """
    count = points.xyz.shape[0]
    kept = torch.nonzero(~idle | points.lasting)[:, 0]
    room = int(config.growth * float(points.first)) - len(kept)
    pull = (points.error / points.shown.clamp(min=1))[kept]
    wanted = max(0, min(room, int(config.share * len(kept)), int((pull > 0).sum())))
    if len(kept) <= NEAREST:
        return Densified(0, 0)
    if wanted == 0:
        points.take(kept)
        return Densified(0, count - len(kept))
    parents = kept[pull.topk(wanted).indices.sort().values]
    parents, partners = _pairs(points.xyz, kept, parents, np.random.default_rng(seed))
    points.take(kept, parents, partners)
    changed = np.append(np.searchsorted(kept.numpy(), parents.numpy()), np.arange(len(kept), points.xyz.shape[0]))
    _draw_together(points, changed)
    return Densified(len(parents), count - len(kept))


def _draw_together(points: FramePoints, rows: NDArray[np.intp]) -> None:
    """Give points that have nearer neighbours now the spacing, and for the time being the radius, that goes with it."""
    nearer = torch.minimum(points.spacing[rows], torch.from_numpy(spacings(points.xyz.numpy(), rows)))
    points.radius[rows] *= nearer / points.spacing[rows]
    points.spacing[rows] = nearer


def _pairs(xyz: Tensor, kept: Tensor, parents: Tensor, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    """Parents and one of the nearest kept points of each; of two that have chosen each other, one alone."""
    _, near = cKDTree(xyz[kept].numpy()).query(xyz[parents].numpy(), k=list(range(2, NEAREST + 2)))
    drawn = near[np.arange(len(parents)), rng.integers(0, NEAREST, len(parents))]
    pairs = torch.stack([parents, kept[torch.from_numpy(drawn)]], 1)
    pairs = torch.from_numpy(np.unique(pairs.sort(dim=1).values.numpy(), axis=0))
    return pairs[:, 0], pairs[:, 1]
