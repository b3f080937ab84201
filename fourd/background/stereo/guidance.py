"""Depth completion with a guide: a coarse depth estimate, corrected by the known depths."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.background.stereo.completion import (
    interpolate_membrane,
    project_inverse_depths,
    remove_occluding,
    with_completed_depths,
)
from fourd.background.stereo.fusion import Surface
from fourd.background.stereo.patches import Floats, GreyView

Array = NDArray[np.float64]

GUIDE_WEIGHT = 0.01
"""Decay of the correction towards the guide, divided by the squared share of known cells. With all cells known, a
correction halves over seven cells; few known cells are unreliable, and their corrections decay faster."""
MIN_GUIDE_FACTOR = 0.25
"""Lower limit of inverse depths relative to the guide, since extrapolated corrections can exceed it."""


def complete_with_guidance(
    surfaces: Sequence[Surface], views: Sequence[GreyView], guides: Sequence[Array]
) -> list[Surface]:
    """Complete the unknown cells of surfaces from guides; completed cells have support 0.

    The difference between known cells and the guide is extrapolated. Cells that would occlude a known surface of
    another picture stay unknown.

    Args:
        surfaces: one per picture.
        views: the pictures; grey edges weaken the extrapolation.
        guides: (N,) inverse depths per picture.
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
    """(R, C) known values; where they are 0, the guide plus the extrapolated difference between known and guide."""
    unknown = known == 0
    if unknown.all():
        return guide
    decay = GUIDE_WEIGHT / (1 - unknown.mean()) ** 2
    correction = interpolate_membrane(np.where(unknown, 0, known - guide), unknown, grey, float(decay))
    return np.where(unknown, np.maximum(guide + correction, MIN_GUIDE_FACTOR * guide), known)
