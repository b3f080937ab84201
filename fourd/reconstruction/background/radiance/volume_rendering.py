"""Compute volume rendering weights (Mildenhall et al. 2020, eq. 3), their distortion loss and their quantiles."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional


def rendering_weights(density: Tensor, lengths: Tensor) -> tuple[Tensor, Tensor]:
    """Compute the volume rendering weights (R, S) of the intervals along R rays, and the final transmittance (R,).

    Both results are differentiable in ``density`` and ``lengths``.

    Args:
        density: (R, S) densities per unit of ``lengths``.
        lengths: (R, S) lengths of the intervals, front to back.
    """
    optical_depth = functional.pad((density * lengths).cumsum(1), (1, 0))
    transmittance = torch.exp(-optical_depth)
    return transmittance[:, :-1] - transmittance[:, 1:], transmittance[:, -1]


def distortion_loss(weights: Tensor, edges: Tensor) -> Tensor:
    """Compute the distortion loss (R,) of mip-NeRF 360 (Barron et al. 2022, eq. 15), which measures how widely the
    weights are spread along a ray.

    The loss is differentiable in ``weights`` and ``edges``.

    Args:
        weights: (R, S) volume rendering weights.
        edges: (R, S + 1) ascending normalised distances of the intervals' edges.
    """
    middles, lengths = (edges[:, 1:] + edges[:, :-1]) / 2, edges.diff(dim=1)
    before = weights.cumsum(1) - weights
    moments = (weights * middles).cumsum(1) - weights * middles
    between = 2 * (weights * (middles * before - moments)).sum(1)
    return between + (weights.square() * lengths).sum(1) / 3


def weight_quantile(weights: Tensor, edges: Tensor, part: float) -> Tensor:
    """Compute the normalised distance (R,) at which the cumulative weight along a ray reaches ``part``, or 1 if the
    total weight is less than ``part``.

    Args:
        weights: (R, S) volume rendering weights.
        edges: (R, S + 1) ascending normalised distances of the intervals' edges.
        part: cumulative weight in [0, 1]; 0.5 gives the median.
    """
    cumulative = functional.pad(weights.cumsum(1), (1, 0))
    target = torch.full_like(cumulative[:, :1], part)
    upper = torch.searchsorted(cumulative, target).clamp(1, weights.shape[1])
    within = ((target - cumulative.gather(1, upper - 1)) / weights.gather(1, upper - 1).clamp(min=1e-9)).clamp(0, 1)
    near, far = edges.gather(1, upper - 1), edges.gather(1, upper)
    return torch.where(cumulative[:, -1:] < part, torch.ones_like(near), near + within * (far - near))[:, 0]
