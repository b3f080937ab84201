"""Fitting a radiance field to clean plates and to what stereo measured in them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from fourd.background.contraction import Contraction
from fourd.background.radiance.config import RadianceConfig
from fourd.background.radiance.field import RadianceField
from fourd.background.radiance.occupancy import OccupancyGrid
from fourd.background.radiance.pixels import Batch, Pixels
from fourd.background.radiance.rays import Rays, to_distance
from fourd.background.radiance.volume_rendering import distortion, light_weights
from fourd.progress import Track, untracked

FINAL_RATE = 0.1
WARM_UP = 50
OPAQUE = 1e6
"""Length of each ray's last interval, so that all light ends: were it to pass, fog before the lens would stop it."""


@dataclass(frozen=True, eq=False)
class FittedField:
    """A field, and the grid that tells where to look in it."""

    radiance: RadianceField
    occupancy: OccupancyGrid

    def look(
        self, rays: Rays, samples: int, generator: torch.Generator | None = None, hint: Tensor | None = None
    ) -> Look:
        """What rays meet, at as many places; differentiable in the field.

        Args:
            rays: R of them.
            samples: S, of each ray.
            generator: of where exactly; None for the same places each time.
            hint: (R,) shares of the rays at which to look too; NaN for none.
        """
        with torch.no_grad():
            jitter = None if generator is None else torch.rand(len(rays), samples + 1, generator=generator)
            edges = self.occupancy.sample(rays, samples, jitter, hint)
            distances = to_distance(edges)
            middles = (distances[:, 1:] + distances[:, :-1]) / 2
            xyz = rays.at(middles, self.radiance.contraction.radius).reshape(-1, 3)
            lengths = distances.diff(dim=1)
            lengths[:, -1] = OPAQUE
        density, place = self.radiance.density(xyz)
        weights, _ = light_weights(density.reshape(len(rays), samples), lengths)
        colour = self.radiance.colour(place).reshape(len(rays), samples, 3)
        return Look(edges, weights, (weights[..., None] * colour).sum(1), xyz, density)


@dataclass(frozen=True, eq=False)
class Look:
    """What R rays met at S places each.

    Attributes:
        edges: (R, S + 1) shares of the rays.
        weights: (R, S) what each interval adds.
        rgb: (R, 3).
        xyz: (R S, 3) world, the places.
        density: (R S,) there.
    """

    edges: Tensor
    weights: Tensor
    rgb: Tensor
    xyz: Tensor
    density: Tensor


def fit_field(
    pixels: Pixels, contraction: Contraction, config: RadianceConfig, seed: int, track: Track = untracked
) -> FittedField:
    """Fit a field to pixels of plates.

    The loss is that of the colours (squared), of depths where there are some (Deng et al. 2022, Depth-supervised NeRF,
    here the mean distance of a ray's light from the depth), and of distortion (Barron et al. 2022, eq. 15). The same
    input, seed and number of torch's threads give the same field.
    """
    generator = torch.Generator().manual_seed(seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        radiance = RadianceField(config.grid, contraction, config.hidden)
    field = FittedField(radiance, OccupancyGrid(contraction, config.occupancy))
    optimizer = torch.optim.Adam(radiance.parameters(), lr=config.rate, betas=(0.9, 0.99), eps=1e-15, fused=True)
    for step in track(range(config.steps), config.steps, "background field: steps"):
        optimizer.param_groups[0]["lr"] = config.rate * _rate(step, config.steps)
        batch = pixels.draw(config.rays, generator)
        look = field.look(batch.rays, config.samples, generator, batch.share)
        with torch.no_grad():
            field.occupancy.update(look.xyz, look.density)
        optimizer.zero_grad(set_to_none=True)
        _loss(look, batch, config).backward()
        optimizer.step()
    radiance.requires_grad_(False)
    return field


def _rate(step: int, steps: int) -> float:
    """Share of the learning rate: it rises for 50 steps, and falls to a tenth."""
    return min(1.0, (step + 1) / WARM_UP) * float(FINAL_RATE ** (step / steps))


def _loss(look: Look, batch: Batch, config: RadianceConfig) -> Tensor:
    middles = (look.edges[:, 1:] + look.edges[:, :-1]) / 2
    away = (look.weights * (middles - batch.share.nan_to_num()[:, None]).abs()).sum(1)
    weight = torch.where(batch.measured, config.measured, config.continued) * ~batch.share.isnan()
    together = distortion(look.weights, look.edges)
    return functional.mse_loss(look.rgb, batch.rgb) + (weight * away).mean() + config.distortion * together.mean()
