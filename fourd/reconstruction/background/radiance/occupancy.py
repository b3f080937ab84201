"""An occupancy grid for importance sampling along rays. Each cell stores a decaying maximum of the densities that the
radiance field had at points in the cell."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from fourd.reconstruction.background.contraction import Contraction
from fourd.reconstruction.background.radiance.rays import RayRange, Rays, resample_edges
from fourd.reconstruction.background.radiance.volume_rendering import rendering_weights

DECAY = 0.95
UNIFORM_WEIGHT = 0.1
"""Total weight of the uniform part of a ray's sampling histogram, which lets samples find surfaces that are missing in
the grid. The part that is computed from the grid's densities has a total weight of at most one."""
BINS = 96
"""Number of bins in the histogram of sampling weights along a ray."""
HINT_WEIGHTS = (0.25, 0.5, 0.25)
"""Weights that a hint adds to three bins of a ray's histogram: the bin before it, its own bin and the bin after it. A
hint is a distance at which the ray is expected to hit a surface, for example the known distance of a training pixel."""


class OccupancyGrid:
    """Densities on a grid over contracted space, used to place more samples in dense cells than in empty ones.

    Instant-NGP (sec. 5.4 and appendix C) marches through occupied cells in equal steps. This class instead computes a
    histogram of the volume rendering weights along each ray from the grid's densities, and draws a fixed number of
    samples from it.
    """

    def __init__(self, contraction: Contraction, cells: int, span: RayRange) -> None:
        """Create an empty grid with ``cells`` cells along each side. ``span`` is the range of all rays."""
        self.contraction = contraction
        self.span = span
        self.cells = cells
        self.density = torch.zeros(cells**3)
        self.edges = torch.linspace(0, 1, BINS + 1)

    def sample(self, rays: Rays, count: int, jitter: Tensor | None, hint: Tensor | None = None) -> Tensor:
        """Sample the edges of the intervals along rays, so that intervals are shorter where the grid is dense.

        Args:
            rays: R rays.
            count: number of intervals per ray.
            jitter: (R, count + 1) offset of each edge within its stratum, in [0, 1). The strata divide the cumulative
                weight of the ray's histogram into count + 1 equal parts. If None, each edge is at the centre of its
                stratum.
            hint: (R,) normalised distance near which the samples of each ray are denser than elsewhere, or NaN for rays
                without a hint.

        Returns:
            (R, count + 1) normalised distances of the intervals' edges.
        """
        middles = (self.edges[1:] + self.edges[:-1]) / 2
        distances = self.span.to_distance(middles).expand(len(rays), -1)
        density = self.density[self.cell_of(rays.at(distances, self.contraction.radius))]
        lengths = self.span.to_distance(self.edges).diff()
        weights, transmittance = rendering_weights(density, lengths.expand_as(distances))
        pooled = functional.max_pool1d(weights[:, None], 3, 1, 1)[:, 0]
        histogram = pooled / 3 + (transmittance[:, None] + UNIFORM_WEIGHT) / BINS
        if hint is not None:
            bins = (hint.nan_to_num() * BINS).long()[:, None] + torch.tensor([-1, 0, 1])
            added = torch.tensor(HINT_WEIGHTS) * ~hint.isnan()[:, None]
            histogram.scatter_add_(1, bins.clamp(0, BINS - 1), added)
        return resample_edges(self.edges, histogram, count, jitter)

    def update(self, xyz: Tensor, density: Tensor) -> None:
        """Update the cells that contain world points (N, 3). The new value of a cell is the maximum of its decayed old
        value and the ``density`` (N,) of its points."""
        cells = self.cell_of(xyz)
        self.density[cells] = self.density[cells] * DECAY
        self.density.scatter_reduce_(0, cells, density, "amax")

    def cell_of(self, xyz: Tensor) -> Tensor:
        """Find the cells that contain world points (..., 3), and return their indices in the array ``density``. The
        indices have the shape of the points without the last axis."""
        ijk = (self.contraction.to_unit(xyz) * self.cells).long().clamp(0, self.cells - 1)
        return (ijk[..., 2] * self.cells + ijk[..., 1]) * self.cells + ijk[..., 0]
