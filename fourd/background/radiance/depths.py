"""What a fitted field says of the plates' depths, held against what stereo measured and against itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.background.radiance.fitting import FittedField
from fourd.background.radiance.rays import camera_rays, to_distance
from fourd.background.radiance.volume_rendering import spent_share
from fourd.background.stereo.depth_maps import Small
from fourd.background.stereo.fusion import Surface, compared
from fourd.background.stereo.patchmatch import DepthMap
from fourd.progress import Track

Array = NDArray[np.float64]

SAMPLES = 64
RAYS = 4096
"""Of a batch."""
FOGGY = 1.25
"""Times as far as a quarter of a ray's light are three quarters of it in fog, which looks alike from all sides."""
NOWHERE = 0.99
"""Share of a ray: light that is spent beyond meets nothing."""


def field_depths(
    field: FittedField,
    smalls: Sequence[Small],
    measured: Sequence[Surface],
    continued: Sequence[Surface],
    track: Track,
) -> list[Surface]:
    """A surface of each plate: measured cells as they are, others at the field's median depth where it is confirmed.

    Confirmed, with support 1, are those that another plate's surface lies at and that hide no more surfaces than
    agree. The others are as ``continued``: of what a single plate shows colours tell no depth, and the field's is
    noise about its guess.
    """
    maps = zip(track(range(len(smalls)), len(smalls), "background field: depths"), smalls, measured, strict=True)
    joined = [_joined(field, small, surface) for _, small, surface in maps]
    return [_confirmed(index, joined, measured[index], continued[index]) for index in range(len(joined))]


def _joined(field: FittedField, small: Small, measured: Surface) -> Surface:
    grid = measured.depths.grid
    inverse = measured.depths.inverse_depth.astype(np.float64)
    asked = ~measured.known
    inverse[asked] = median_inverse_depths(field, small, grid.pixels[asked, :2].astype(np.float64))
    mine = DepthMap.through(grid, inverse, np.zeros(len(inverse), np.float32))
    planes = np.where(measured.known[:, None], measured.depths.planes, mine.planes)
    scores = np.where(measured.known, measured.depths.scores, mine.scores)
    known = measured.known | ((inverse > 0) & small.seen[grid.indices])
    return Surface(small.camera, DepthMap(grid, planes, scores), known, measured.support * measured.known)


def median_inverse_depths(field: FittedField, small: Small, xy: Array) -> Array:
    """(M,) one by the depth at which half of the light is spent, at indices (M, 2) of pixels; 0 for fog and nothing."""
    unit = field.radiance.contraction.radius
    parts: list[Tensor] = []
    with torch.no_grad():
        for places in torch.from_numpy(xy + 0.5).split(RAYS):
            rays = camera_rays(small.camera, places)
            look = field.look(rays, SAMPLES)
            shares = [spent_share(look.weights, look.edges, part) for part in (0.25, 0.5, 0.75)]
            near, middle, far = (to_distance(share) for share in shares)
            depth = middle * unit * (rays.directions @ torch.tensor(small.camera.forward).float())
            parts.append(torch.where((far < FOGGY * near) & (shares[1] < NOWHERE), 1 / depth, 0))
    return np.asarray(torch.cat(parts).double().numpy(), np.float64)


def _confirmed(index: int, joined: Sequence[Surface], measured: Surface, continued: Surface) -> Surface:
    mine = joined[index]
    cells = np.flatnonzero(mine.known & ~measured.known)
    alike, hiding = compared(index, joined, cells)
    found = np.zeros_like(mine.known)
    found[cells] = (alike > 0) & (hiding <= alike)
    taken = measured.known | found
    planes = np.where(taken[:, None], mine.depths.planes, continued.depths.planes)
    depths = replace(mine.depths, planes=planes)
    return Surface(mine.camera, depths, taken | continued.known, np.where(found, 1, measured.support * measured.known))
