"""Optimise a radiance field on clean plates and stereo depths."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from fourd.base.progress import Track, untracked
from fourd.reconstruction.background.contraction import Contraction
from fourd.reconstruction.background.radiance.config import RadianceConfig
from fourd.reconstruction.background.radiance.field import RadianceField
from fourd.reconstruction.background.radiance.occupancy import OccupancyGrid
from fourd.reconstruction.background.radiance.pixels import Batch, Pixels
from fourd.reconstruction.background.radiance.rays import Rays
from fourd.reconstruction.background.radiance.volume_rendering import distortion_loss, rendering_weights

FINAL_RATE_FACTOR = 0.1
WARM_UP = 50
OPAQUE_LENGTH = 1e6
"""Length of each ray's last interval, in units of the contraction's radius. This large length makes every ray opaque.
If rays could stay partly transparent, the optimisation would create fog in front of the cameras."""


@dataclass(frozen=True, eq=False)
class OptimizedField:
    """A radiance field with its occupancy grid."""

    radiance: RadianceField
    occupancy: OccupancyGrid

    def render(
        self, rays: Rays, samples: int, generator: torch.Generator | None = None, hint: Tensor | None = None
    ) -> RenderedRays:
        """Render rays. The result is differentiable in the field's parameters.

        Args:
            rays: R rays.
            samples: number S of samples per ray.
            generator: random generator of the samples' jitter; if None, the samples have no jitter.
            hint: (R,) normalised distance near which the samples of each ray are denser than elsewhere, or NaN for rays
                without a hint.
        """
        with torch.no_grad():
            jitter = None if generator is None else torch.rand(len(rays), samples + 1, generator=generator)
            edges = self.occupancy.sample(rays, samples, jitter, hint)
            distances = self.occupancy.span.to_distance(edges)
            middles = (distances[:, 1:] + distances[:, :-1]) / 2
            xyz = rays.at(middles, self.radiance.contraction.radius).reshape(-1, 3)
            lengths = distances.diff(dim=1)
            lengths[:, -1] = OPAQUE_LENGTH
        density, features = self.radiance.density(xyz)
        weights, _ = rendering_weights(density.reshape(len(rays), samples), lengths)
        colour = self.radiance.colour(features).reshape(len(rays), samples, 3)
        return RenderedRays(edges, weights, (weights[..., None] * colour).sum(1), xyz, density)


@dataclass(frozen=True, eq=False)
class RenderedRays:
    """R rendered rays with S samples each.

    Attributes:
        edges: (R, S + 1) normalised distances of the interval edges.
        weights: (R, S) volume rendering weights.
        rgb: (R, 3) composited RGB colours in [0, 1].
        xyz: (R * S, 3) world points of the samples.
        density: (R * S,) densities of the samples.
    """

    edges: Tensor
    weights: Tensor
    rgb: Tensor
    xyz: Tensor
    density: Tensor


def optimize_field(
    pixels: Pixels, contraction: Contraction, config: RadianceConfig, seed: int, track: Track = untracked
) -> OptimizedField:
    """Optimise a radiance field on pixels of plates.

    The loss is a weighted sum of the squared colour error, a depth loss and the distortion loss (Barron et al. 2022,
    eq. 15). The depth loss applies to pixels with a known depth, as in Depth-supervised NeRF (Deng et al. 2022). For a
    ray, it is the mean absolute difference between the normalised distances of the samples and of the surface, weighted
    by the samples' rendering weights. The same input, seed and number of torch threads give the same field.
    """
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        radiance = RadianceField(config.grid, contraction, config.hidden)
    field = OptimizedField(radiance, OccupancyGrid(contraction, config.occupancy, pixels.span))
    optimizer = torch.optim.Adam(radiance.parameters(), lr=config.rate, betas=(0.9, 0.99), eps=1e-15, fused=True)
    for step in track(range(config.steps), config.steps, "background field: steps"):
        optimizer.param_groups[0]["lr"] = config.rate * _rate_factor(step, config.steps)
        batch = pixels.sample(config.rays, generator)
        rendered = field.render(batch.rays, config.samples, generator, batch.surface)
        with torch.no_grad():
            field.occupancy.update(rendered.xyz, rendered.density)
        optimizer.zero_grad(set_to_none=True)
        _loss(rendered, batch, config).backward()
        optimizer.step()
    radiance.requires_grad_(False)
    return field


def _rate_factor(step: int, steps: int) -> float:
    """Compute the factor of the learning rate: a linear rise to 1 over the first 50 steps, times an exponential decay
    from 1 to 0.1 over all steps."""
    return min(1.0, (step + 1) / WARM_UP) * float(FINAL_RATE_FACTOR ** (step / steps))


def _loss(rendered: RenderedRays, batch: Batch, config: RadianceConfig) -> Tensor:
    middles = (rendered.edges[:, 1:] + rendered.edges[:, :-1]) / 2
    depth_error = (rendered.weights * (middles - batch.surface.nan_to_num()[:, None]).abs()).sum(1)
    weight = torch.where(batch.measured, config.measured, config.continued) * ~batch.surface.isnan()
    distortion = distortion_loss(rendered.weights, rendered.edges).mean()
    colour_error = functional.mse_loss(rendered.rgb, batch.rgb)
    return colour_error + (weight * depth_error).mean() + config.distortion * distortion
