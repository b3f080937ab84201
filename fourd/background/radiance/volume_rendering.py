"""Where the light of rays is spent (Mildenhall et al. 2020, eq. 3)."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional


def light_weights(density: Tensor, lengths: Tensor) -> tuple[Tensor, Tensor]:
    """What each of S intervals adds to a ray's colour (R, S), and the light (R,) that passes them all.

    Args:
        density: (R, S), per unit of ``lengths``.
        lengths: (R, S) of the intervals, front to back.

    Differentiable in both.
    """
    depth = functional.pad((density * lengths).cumsum(1), (1, 0))
    passing = torch.exp(-depth)
    return passing[:, :-1] - passing[:, 1:], passing[:, -1]


def distortion(weights: Tensor, edges: Tensor) -> Tensor:
    """How far each ray's weights are from lying in one place (R,) (Barron et al. 2022, eq. 15).

    Args:
        weights: (R, S).
        edges: (R, S + 1) ascending, as shares of the ray.
    """
    middles, lengths = (edges[:, 1:] + edges[:, :-1]) / 2, edges.diff(dim=1)
    before = weights.cumsum(1) - weights
    moments = (weights * middles).cumsum(1) - weights * middles
    between = 2 * (weights * (middles * before - moments)).sum(1)
    return between + (weights.square() * lengths).sum(1) / 3


def spent_share(weights: Tensor, edges: Tensor, part: float) -> Tensor:
    """Share of the ray (R,) at which a part of its light, 0 to 1, is spent; 1 where less than that is.

    Args:
        weights: (R, S).
        edges: (R, S + 1) ascending, as shares of the ray.
        part: 0.5 gives the median.
    """
    spent = functional.pad(weights.cumsum(1), (1, 0))
    wanted = torch.full_like(spent[:, :1], part)
    upper = torch.searchsorted(spent, wanted).clamp(1, weights.shape[1])
    within = ((wanted - spent.gather(1, upper - 1)) / weights.gather(1, upper - 1).clamp(min=1e-9)).clamp(0, 1)
    near, far = edges.gather(1, upper - 1), edges.gather(1, upper)
    return torch.where(spent[:, -1:] < part, torch.ones_like(near), near + within * (far - near))[:, 0]
