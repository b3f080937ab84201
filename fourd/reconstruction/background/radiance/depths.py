"""Render depth maps of the plates from an optimised field, and keep only depths that are consistent between plates.

In this module, a cell is one sample of a plate's depth map. The support of a cell is the number of other plates that
confirm its depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.progress import Track
from fourd.reconstruction.background.radiance.optimization import OptimizedField
from fourd.reconstruction.background.radiance.rays import camera_rays
from fourd.reconstruction.background.radiance.volume_rendering import weight_quantile
from fourd.recording.stereo.depth_maps import ReducedPlate
from fourd.recording.stereo.fusion import Surface, count_agreement
from fourd.recording.stereo.patchmatch import DepthMap

Array = NDArray[np.float64]

SAMPLES = 64
RAYS = 4096
"""Number of rays per batch."""
MAX_QUARTILE_RATIO = 1.25
"""Maximum ratio of the upper to the lower quartile of the distances along a ray, weighted by the rendering weights.
Above this ratio, the rendering weights are too spread out to describe a surface."""
MAX_MEDIAN = 0.99
"""Maximum normalised distance, in [0, 1] (see :class:`~fourd.reconstruction.background.radiance.rays.RayRange`), at
which a ray's cumulative rendering weight reaches 1/2. If the weight reaches 1/2 farther away, the ray is assumed to hit
no surface."""


def add_field_depths(
    field: OptimizedField,
    plates: Sequence[ReducedPlate],
    measured: Sequence[Surface],
    continued: Sequence[Surface],
    track: Track,
) -> list[Surface]:
    """Add depths to those cells of surfaces whose depth stereo did not measure. A cell gets the median depth of the
    field if another plate confirms this depth, and otherwise the extrapolated depth.

    Let A be the number of other plates whose surfaces agree with a cell's depth, and O the number of other plates whose
    surfaces the cell would occlude. The cell is confirmed if A >= 1 and O <= A. Confirmed cells get support 1.
    Unconfirmed cells take the extrapolated depth of ``continued`` instead of the field's depth, for the following
    reason. Where only one plate sees a surface, colours do not determine its depth. There, the field only reproduces,
    with noise, the extrapolated depth, which is the target of its depth loss.

    Args:
        field: the optimised field.
        plates: the plates at the size used for stereo.
        measured: surfaces from stereo, one per plate.
        continued: the same surfaces with extrapolated depths in unknown cells.
        track: progress callback.
    """
    maps = zip(track(range(len(plates)), len(plates), "background field: depths"), plates, measured, strict=True)
    merged = [_merge_depths(field, plate, surface) for _, plate, surface in maps]
    return [_keep_confirmed(index, merged, measured[index], continued[index]) for index in range(len(merged))]


def _merge_depths(field: OptimizedField, plate: ReducedPlate, measured: Surface) -> Surface:
    """Add the field's median depths to those cells of the surface ``measured`` whose depth stereo did not measure."""
    grid = measured.depths.grid
    inverse = measured.depths.inverse_depth.astype(np.float64)
    unknown = ~measured.known
    inverse[unknown] = median_inverse_depths(field, plate, grid.pixels[unknown, :2].astype(np.float64))
    own = DepthMap.from_inverse_depth(grid, inverse, np.zeros(len(inverse), np.float32))
    planes = np.where(measured.known[:, None], measured.depths.planes, own.planes)
    scores = np.where(measured.known, measured.depths.scores, own.scores)
    known = measured.known | ((inverse > 0) & plate.seen[grid.indices])
    return Surface(plate.camera, DepthMap(grid, planes, scores), known, measured.support * measured.known)


def median_inverse_depths(field: OptimizedField, plate: ReducedPlate, xy: Array) -> Array:
    """Compute the inverse depths (M,) at which the cumulative rendering weight along the rays through the pixel indices
    ``xy`` (M, 2) reaches 1/2. The value is 0 for rays without a surface.
    """
    unit = field.radiance.contraction.radius
    parts: list[Tensor] = []
    with torch.no_grad():
        for pixels in torch.from_numpy(xy + 0.5).split(RAYS):
            rays = camera_rays(plate.camera, pixels)
            rendered = field.render(rays, SAMPLES)
            quartiles = [weight_quantile(rendered.weights, rendered.edges, part) for part in (0.25, 0.5, 0.75)]
            near, middle, far = (field.occupancy.span.to_distance(quartile) for quartile in quartiles)
            depth = middle * unit * (rays.directions @ torch.tensor(plate.camera.forward).float())
            parts.append(torch.where((far < MAX_QUARTILE_RATIO * near) & (quartiles[1] < MAX_MEDIAN), 1 / depth, 0))
    return np.asarray(torch.cat(parts).double().numpy(), np.float64)


def _keep_confirmed(index: int, merged: Sequence[Surface], measured: Surface, continued: Surface) -> Surface:
    """Return ``merged[index]``, with some cells replaced by those of ``continued``: the cells whose depth is neither
    measured by stereo nor confirmed by another plate."""
    surface = merged[index]
    cells = np.flatnonzero(surface.known & ~measured.known)
    agreeing, occluded = count_agreement(index, merged, cells)
    confirmed = np.zeros_like(surface.known)
    confirmed[cells] = (agreeing > 0) & (occluded <= agreeing)
    kept = measured.known | confirmed
    planes = np.where(kept[:, None], surface.depths.planes, continued.depths.planes)
    depths = replace(surface.depths, planes=planes)
    support = np.where(confirmed, 1, measured.support * measured.known)
    return Surface(surface.camera, depths, kept | continued.known, support)
