"""The radiance field: a hash grid and two small networks (Instant-NGP, Mueller et al. 2022, sec. 5.4)."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from fourd.background.contraction import Contraction
from fourd.ops.hashgrid.op import encode_hash_grid
from fourd.ops.hashgrid.shape import HashGridShape

PLACE_FEATURES = 15
START_LOG_DENSITY = -2.0
LARGEST_LOG_DENSITY = 11.0


class RadianceField(nn.Module):
    """Density and colour of all points of space; the same from all sides.

    Without a say of the viewing direction no plate can be explained by itself, by light that only its camera sees.
    Densities are per :attr:`Contraction.radius`, the unit in which rays are measured.
    """

    def __init__(self, shape: HashGridShape, contraction: Contraction, hidden: int) -> None:
        """Random and nearly empty; ``hidden`` is the width of both networks."""
        super().__init__()
        self.shape = shape
        self.contraction = contraction
        self.table = nn.Parameter(torch.empty(shape.total_entries, shape.features).uniform_(-1e-4, 1e-4))
        self.density_layers = nn.Sequential(
            nn.Linear(shape.out_features, hidden, bias=False),
            nn.ReLU(),
            nn.Linear(hidden, 1 + PLACE_FEATURES, bias=False),
        )
        self.colour_layers = nn.Sequential(
            nn.Linear(PLACE_FEATURES, hidden, bias=False), nn.ReLU(), nn.Linear(hidden, 3, bias=False)
        )

    def density(self, xyz: Tensor) -> tuple[Tensor, Tensor]:
        """World points (N, 3) -> density (N,), and what :meth:`colour` takes of the place (N, 15)."""
        found = self.density_layers(encode_hash_grid(self.contraction.to_unit(xyz), self.table, self.shape))
        return bounded_exp(found[:, 0] + START_LOG_DENSITY), found[:, 1:]

    def colour(self, place: Tensor) -> Tensor:
        """(N, 15) of :meth:`density` -> (N, 3) in [0, 1]."""
        return torch.sigmoid(self.colour_layers(place))


def bounded_exp(log_density: Tensor) -> Tensor:
    """exp of at most 11, whose gradient does not vanish there: a density may always fall again."""
    return torch.Tensor(_BoundedExp.apply(log_density))


class _BoundedExp(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, log_density: Tensor) -> Tensor:
        density = torch.exp(log_density.clamp(max=LARGEST_LOG_DENSITY))
        ctx.save_for_backward(density)
        return density

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        (density,) = ctx.saved_tensors
        return gradient * density
