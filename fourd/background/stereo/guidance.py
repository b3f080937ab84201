"""Depths of pictures of which stereo knows little: a guide, moved to what is known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.background.stereo.completion import membrane, others_in, with_guesses, without_hiding
from fourd.background.stereo.fusion import Surface
from fourd.background.stereo.patches import Floats, GreyView

Array = NDArray[np.float64]

PULL = 0.01
"""Of a difference to a guide towards none, by the square of the share of a picture that is known: where all is, it is
half gone after seven cells; where little is, much of that is chance, and it is gone at once."""
LEAST_OF_GUIDE = 0.25
"""Inverse depths stay above so much of the guide's: differences that are continued may be larger than it."""


def guided(surfaces: Sequence[Surface], views: Sequence[GreyView], guides: Sequence[Array]) -> list[Surface]:
    """The surfaces with all cells known, of which those that were not have support 0.

    What is continued from the known cells is how much they differ from the guide. Cells that would hide what another
    picture knows are left unknown.

    Args:
        surfaces: one of each picture.
        views: the pictures.
        guides: (N,) inverse depths for each picture's cells.
    """
    xyz = np.concatenate([surface.points(np.flatnonzero(surface.known)) for surface in surfaces])
    guessed = [_guided(*each, xyz) for each in zip(surfaces, views, guides, strict=True)]
    return [without_hiding(index, guessed, surfaces) for index in range(len(surfaces))]


def _guided(surface: Surface, view: GreyView, guide: Array, xyz: Array) -> Surface:
    grid = surface.depths.grid
    known = others_in(surface, xyz, 0)
    known = np.where(surface.known, surface.depths.inverse_depth, known.ravel()).reshape(grid.shape)
    grey = np.nan_to_num(view.greys[1])[grid.indices].reshape(grid.shape)
    return with_guesses(surface, _moved(known, guide.reshape(grid.shape), grey).ravel())


def _moved(known: Array, guide: Array, grey: Floats) -> Array:
    """(R, C) the values, those that are 0 such that what they are more than the guide is continued from around."""
    unknown = known == 0
    if unknown.all():
        return guide
    pull = PULL / (1 - unknown.mean()) ** 2
    more = membrane(np.where(unknown, 0, known - guide), unknown, grey, float(pull))
    return np.where(unknown, np.maximum(guide + more, LEAST_OF_GUIDE * guide), known)
