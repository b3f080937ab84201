"""Densification: split points with large gradients, and remove points that no training view observes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from torch import Tensor

from fourd.reconstruction.training.config import DensifyConfig
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.reconstruction.training.points.spacing import point_spacings
from fourd.rendering.ops.moves import add_magnitudes, has_kernels

NEIGHBOURS = 3
"""A point that is split (the parent) gets a partner, which is chosen at random from this number of nearest neighbours.
The split adds a new point midway between parent and partner. The new point is close to the surface, because the two are
near neighbours."""


@dataclass(frozen=True)
class Densification:
    """Numbers of points that one densification added and removed."""

    added: int
    removed: int


def accumulate_gradient_magnitudes(points: FramePoints, rows: Tensor, gradient: Tensor) -> None:
    """Add the gradient magnitudes of one training step to the gradient history of the points ``rows`` (M,).
    ``gradient`` (M, 3) is the gradient of the loss with respect to their positions.

    The magnitude is the norm of a point's gradient times the point's spacing. To first order, it is the largest change
    of the loss when the point moves by one spacing. Because the movement is one spacing and not a fixed length, the
    magnitudes of points in dense regions and in sparse regions can be compared. In contrast, Kerbl et al. 2023, sec.
    5.2, split points with large view-space gradients.
    """
    points.age += 1
    if has_kernels(rows, gradient, points.spacing, points.gradient_sum, points.visible_steps):
        add_magnitudes(rows, gradient, points.spacing, points.gradient_sum, points.visible_steps)
        return
    magnitude = torch.nan_to_num(gradient).norm(dim=1) * points.spacing[rows]
    points.gradient_sum[rows] += magnitude
    points.visible_steps[rows] += (magnitude > 0).float()


def unobserved_points(points: FramePoints, patience: int) -> Tensor:
    """Return an (N,) bool mask of the points that are at least ``patience`` steps old and have never had a gradient."""
    return (points.visible_steps == 0) & (points.age - points.created_at >= patience)


def densify(points: FramePoints, config: DensifyConfig, unobserved: Tensor, seed: list[int]) -> Densification:
    """Split the points with the largest mean gradient magnitudes and remove unobserved points, in place.

    At most the fraction ``config.share`` of the points is split. Splitting stops when the number of points reaches
    ``config.growth`` times the initial number. A new point gets the mean parameters of its parent and its partner, a
    fresh optimizer state and an empty gradient history.

    Args:
        points: the points of one frame or of the background.
        config: limits of densification.
        unobserved: (N,) bool, true for points to remove. Points with ``is_permanent`` are kept in any case.
        seed: seed of the random choice of partners.
    """
    count = points.xyz.shape[0]
    kept = torch.nonzero(~unobserved | points.is_permanent)[:, 0]
    room = int(config.growth * float(points.initial_count)) - len(kept)
    magnitude = (points.gradient_sum / points.visible_steps.clamp(min=1))[kept]
    split_count = max(0, min(room, int(config.share * len(kept)), int((magnitude > 0).sum())))
    if len(kept) <= NEIGHBOURS:
        return Densification(0, 0)
    if split_count == 0:
        points.keep_and_insert(kept)
        return Densification(0, count - len(kept))
    parents = kept[magnitude.topk(split_count).indices.sort().values]
    parents, partners = _choose_partners(points.xyz, kept, parents, np.random.default_rng(seed))
    points.keep_and_insert(kept, parents, partners)
    places = torch.searchsorted(kept, parents.contiguous()).cpu().numpy()
    changed = np.append(places, np.arange(len(kept), points.xyz.shape[0]))
    _reduce_spacings(points, changed)
    return Densification(len(parents), count - len(kept))


def _reduce_spacings(points: FramePoints, rows: NDArray[np.intp]) -> None:
    """Reduce the spacing and the radius of points that are closer to their neighbours than before the split."""
    measured = torch.from_numpy(point_spacings(points.xyz.cpu().numpy(), rows)).to(points.spacing)
    spacing = torch.minimum(points.spacing[rows], measured)
    points.radius[rows] *= spacing / points.spacing[rows]
    points.spacing[rows] = spacing


def _choose_partners(xyz: Tensor, kept: Tensor, parents: Tensor, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    """Pair each parent with a partner that is chosen at random from the parent's NEIGHBOURS nearest neighbours among
    the kept points. If two parents choose each other, the pair is included once."""
    _, near = cKDTree(xyz[kept].cpu().numpy()).query(xyz[parents].cpu().numpy(), k=list(range(2, NEIGHBOURS + 2)))
    drawn = np.asarray(near)[np.arange(len(parents)), rng.integers(0, NEIGHBOURS, len(parents))]
    pairs = torch.stack([parents, kept[torch.from_numpy(drawn).to(kept)]], 1)
    pairs = torch.from_numpy(np.unique(pairs.sort(dim=1).values.cpu().numpy(), axis=0)).to(pairs)
    return pairs[:, 0], pairs[:, 1]
