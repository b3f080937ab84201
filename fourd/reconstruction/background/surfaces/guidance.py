"""Depth completion with a guide. A guide is a coarse depth estimate, which is corrected by the known depths."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.reconstruction.background.surfaces.completion import (
    interpolate_inverse_depths,
    project_inverse_depths,
    remove_occluding,
    with_completed_depths,
)
from fourd.recording.stereo.fusion import Surface
from fourd.recording.stereo.patches import Floats, GreyView

Array = NDArray[np.float64]

GUIDE_WEIGHT = 0.01
"""Weight of the value 0 in the correction of an unknown cell. The correction of a known cell is its inverse depth minus
the guide's inverse depth. The correction of an unknown cell is the weighted mean of its neighbours' corrections (each
with a weight of at most 1) and of the value 0 (with the weight GUIDE_WEIGHT). The value 0 makes corrections decay with
the distance from known cells: they halve every seven cells. If few cells are known, they are unreliable, and the
corrections must decay faster; therefore, GUIDE_WEIGHT is divided by the square of the fraction of known cells."""
MIN_GUIDE_FACTOR = 0.25
"""Minimum of the corrected inverse depth, as a multiple of the guide's inverse depth. It prevents the correction from
making the inverse depth negative."""


def complete_with_guidance(
    surfaces: Sequence[Surface], views: Sequence[GreyView], guides: Sequence[Array]
) -> list[Surface]:
    """Complete surfaces: extrapolate depths into their unknown cells with the help of guides, which are coarse
    estimates of the depths of all cells.

    The correction of the guide is the known inverse depth minus the guide's inverse depth. It is extrapolated into
    unknown cells and added to the guide there. Cells that would occlude a known surface of another image stay unknown.
    Completed cells have support 0, because no other image confirms them.

    Args:
        surfaces: one surface per image.
        views: the images. Extrapolation weights are lower across edges in the images.
        guides: inverse depths (N,) of the cells, one array per image.
    """
    xyz = np.concatenate([surface.points(np.flatnonzero(surface.known)) for surface in surfaces])
    completed = [_complete(*each, xyz) for each in zip(surfaces, views, guides, strict=True)]
    return [remove_occluding(index, completed, surfaces) for index in range(len(surfaces))]


def _complete(surface: Surface, view: GreyView, guide: Array, xyz: Array) -> Surface:
    grid = surface.depths.grid
    known = project_inverse_depths(surface, xyz, 0)
    known = np.where(surface.known, surface.depths.inverse_depth, known.ravel()).reshape(grid.shape)
    grey = np.nan_to_num(view.greys[1])[grid.indices].reshape(grid.shape)
    return with_completed_depths(surface, _correct_guide(known, guide.reshape(grid.shape), grey).ravel())


def _correct_guide(known: Array, guide: Array, grey: Floats) -> Array:
    """Fill the unknown cells of an inverse-depth map. The array ``known`` (R, C) has the inverse depths of the known
    cells, and 0 in the unknown cells. An unknown cell gets the guide's inverse depth plus the extrapolated correction,
    but at least MIN_GUIDE_FACTOR times the guide's inverse depth."""
    unknown = known == 0
    if unknown.all():
        return guide
    decay = GUIDE_WEIGHT / (1 - unknown.mean()) ** 2
    correction = interpolate_inverse_depths(np.where(unknown, 0, known - guide), unknown, grey, float(decay))
    return np.where(unknown, np.maximum(guide + correction, MIN_GUIDE_FACTOR * guide), known)
