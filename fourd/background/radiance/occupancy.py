"""A grid of densities seen lately: it tells where on a ray something may be, so that the field is asked there."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from fourd.background.contraction import Contraction
from fourd.background.radiance.rays import Rays, resampled, to_distance
from fourd.background.radiance.volume_rendering import light_weights

FADING = 0.95
EVERYWHERE = 0.1
"""Weight of all of a ray beside that of what the grid has on it, up to 1: what the grid missed must be found."""
STEPS = 96
"""Places on a ray at which the grid is asked."""
HINT = (0.25, 0.5, 0.25)
"""What a hint adds to a ray's histogram, in its bin and the two beside it."""


class OccupancyGrid:
    """Densities on a grid over contracted space; empty cells get few samples, full ones many.

    Instant-NGP (sec. 5.4 and appendix C) steps through occupied cells evenly; here the grid's densities are a
    histogram along the ray, so that a set number of samples falls where the light is spent.
    """

    def __init__(self, contraction: Contraction, cells: int) -> None:
        """Empty, with ``cells`` a side."""
        self.contraction = contraction
        self.cells = cells
        self.density = torch.zeros(cells**3)
        self.edges = torch.linspace(0, 1, STEPS + 1)

    def sample(self, rays: Rays, count: int, jitter: Tensor | None, hint: Tensor | None = None) -> Tensor:
        """Edges (R, count + 1) as shares of the rays, of the intervals to look at.

        Args:
            count: of intervals on a ray.
            jitter: (R, count + 1) in [0, 1), or None for the same edges each time.
            hint: (R,) shares at which to look closely too; NaN for none.
        """
        middles = (self.edges[1:] + self.edges[:-1]) / 2
        distances = to_distance(middles).expand(len(rays), -1)
        density = self.density[self.cell_of(rays.at(distances, self.contraction.radius))]
        weights, passing = light_weights(density, to_distance(self.edges).diff().expand_as(distances))
        histogram = functional.max_pool1d(weights[:, None], 3, 1, 1)[:, 0] / 3 + (passing[:, None] + EVERYWHERE) / STEPS
        if hint is not None:
            bins = (hint.nan_to_num() * STEPS).long()[:, None] + torch.tensor([-1, 0, 1])
            more = torch.tensor(HINT) * ~hint.isnan()[:, None]
            histogram.scatter_add_(1, bins.clamp(0, STEPS - 1), more)
        return resampled(self.edges, histogram, count, jitter)

    def update(self, xyz: Tensor, density: Tensor) -> None:
        """Take note of densities (N,) found at world points (N, 3): a cell's fades, unless it is found again."""
        cells = self.cell_of(xyz)
        self.density[cells] = self.density[cells] * FADING
        self.density.scatter_reduce_(0, cells, density, "amax")

    def cell_of(self, xyz: Tensor) -> Tensor:
        """World points (..., 3) -> indices (...) into ``density``."""
        places = (self.contraction.to_unit(xyz) * self.cells).long().clamp(0, self.cells - 1)
        return (places[..., 2] * self.cells + places[..., 1]) * self.cells + places[..., 0]
