"""Residual field: a learnt displacement of the points."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from fourd.reconstruction.model.config import ModelConfig, PlanesConfig
from fourd.reconstruction.model.kplanes import KPlanes


class ResidualField(nn.Module):
    """A small K-Planes model, followed by an MLP that displaces points. The displacement along each axis is at most
    ``residual_range`` times the longest side of the bounds."""

    def __init__(self, config: ModelConfig, sides: tuple[float, float, float], frame_count: int) -> None:
        super().__init__()
        planes = PlanesConfig(levels=2, features=config.planes.features, base_resolution=64, time=config.planes.time)
        self.planes = KPlanes(planes, sides, frame_count)
        self.range = config.residual_range * max(sides)
        self.layers = nn.Sequential(
            nn.Linear(self.planes.out_features, config.hidden), nn.ReLU(), nn.Linear(config.hidden, 3)
        )
        last = self.layers[-1]
        assert isinstance(last, nn.Linear)
        nn.init.uniform_(last.weight, -1e-4, 1e-4)
        nn.init.zeros_(last.bias)

    def forward(self, coordinates: Tensor) -> Tensor:
        """Compute displacements (N, 3) in world units at coordinates (N, 4) in [-1, 1]."""
        return self.range * torch.tanh(self.layers(self.planes(coordinates)))
