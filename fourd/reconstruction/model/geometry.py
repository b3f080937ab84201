"""Geometry head: predicts the radius and density of a point from the point's feature."""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

from fourd.reconstruction.model.config import ModelConfig

DENSITY_OFFSET = 5.0
"""Constant that is added to the density's logit, so that points are nearly opaque at the start of training."""


class GeometryHead(nn.Module):
    """MLP with two hidden layers that predicts radius and density (4K4D, eq. 1 and supplement).

    From the MLP's outputs a and b, the radius is ``low + (high - low) * sigmoid(a + offset)``, as a multiple of the
    point spacing, and the density is ``sigmoid(b + DENSITY_OFFSET)``. Here, (low, high) is
    ``ModelConfig.radius_range``, and the offset is chosen such that ``a = 0`` gives the initial radius
    ``ModelConfig.radius_start``.
    """

    def __init__(self, in_features: int, config: ModelConfig) -> None:
        super().__init__()
        low, high = config.radius_range
        start = (config.radius_start - low) / (high - low)
        self.radius_offset = math.log(start / (1 - start))
        self.radius_low = low
        self.radius_high = high
        self.first = nn.Linear(in_features, config.hidden)
        self.layers = nn.Sequential(
            nn.ReLU(),
            nn.Linear(config.hidden, config.hidden),
            nn.ReLU(),
            nn.Linear(config.hidden, 2),
        )
        last = self.layers[-1]
        assert isinstance(last, nn.Linear)
        nn.init.uniform_(last.weight, -1e-3, 1e-3)
        nn.init.zeros_(last.bias)

    def forward(self, hidden: Tensor) -> tuple[Tensor, Tensor]:
        """Compute the radii (N,), as multiples of the spacing, and the densities (N,) in (0, 1). The input ``hidden``
        (N, H) is the output of the layer ``first``."""
        raw_radius, raw_density = self.layers(hidden).unbind(-1)
        share = torch.sigmoid(raw_radius + self.radius_offset)
        radius = self.radius_low + (self.radius_high - self.radius_low) * share
        return radius, torch.sigmoid(raw_density + DENSITY_OFFSET)
