"""The radiance field: a hash grid and two small networks (Instant-NGP, Mueller et al. 2022, sec. 5.4)."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from fourd.reconstruction.background.contraction import Contraction
from fourd.rendering.ops.hashgrid.op import encode_hash_grid
from fourd.rendering.ops.hashgrid.shape import HashGridShape

GEOMETRY_FEATURES = 15
INITIAL_LOG_DENSITY = -2.0
MAX_LOG_DENSITY = 11.0


class RadianceField(nn.Module):
    """Density and view-independent colour of points in space.

    The colour does not depend on the view. Otherwise, the field could fit each plate with radiance that only this
    plate's camera sees, even if the geometry is wrong. Densities and distances along rays use
    :attr:`Contraction.radius` as the unit of length.
    """

    def __init__(self, shape: HashGridShape, contraction: Contraction, hidden: int) -> None:
        """Initialise the field with random values that give a low density. ``hidden`` is the width of both networks'
        hidden layers."""
        super().__init__()
        self.shape = shape
        self.contraction = contraction
        self.table = nn.Parameter(torch.empty(shape.total_entries, shape.features).uniform_(-1e-4, 1e-4))
        self.density_layers = nn.Sequential(
            nn.Linear(shape.out_features, hidden, bias=False),
            nn.ReLU(),
            nn.Linear(hidden, 1 + GEOMETRY_FEATURES, bias=False),
        )
        self.colour_layers = nn.Sequential(
            nn.Linear(GEOMETRY_FEATURES, hidden, bias=False), nn.ReLU(), nn.Linear(hidden, 3, bias=False)
        )

    def density(self, xyz: Tensor) -> tuple[Tensor, Tensor]:
        """Compute densities (N,) of world points (N, 3), and geometry features (N, 15) for :meth:`colour`."""
        output = self.density_layers(encode_hash_grid(self.contraction.to_unit(xyz), self.table, self.shape))
        return bounded_exp(output[:, 0] + INITIAL_LOG_DENSITY), output[:, 1:]

    def colour(self, features: Tensor) -> Tensor:
        """Compute RGB colours (N, 3) in [0, 1] from geometry features (N, 15) that :meth:`density` returned."""
        return torch.sigmoid(self.colour_layers(features))


def bounded_exp(log_density: Tensor) -> Tensor:
    """Compute the exponential function, clamped to at most exp(11).

    Where the value is clamped, the gradient is not zero, so that high densities can still decrease.
    """
    return torch.Tensor(_BoundedExp.apply(log_density))


class _BoundedExp(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, log_density: Tensor) -> Tensor:
        density = torch.exp(log_density.clamp(max=MAX_LOG_DENSITY))
        ctx.save_for_backward(density)
        return density

    @staticmethod
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        (density,) = ctx.saved_tensors
        return gradient * density
