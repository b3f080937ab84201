"""Depths of what no two pictures show alike: continued from what is known, as a membrane is spanned by a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import spsolve

from fourd.seeding.stereo.depth import DepthMap
from fourd.seeding.stereo.fusing import Surface
from fourd.seeding.stereo.patches import Floats, GreyView

Array = NDArray[np.float64]

MARGIN = 0.25
"""Of the picture's sides: how far beyond them what other pictures know is taken in."""
LEAST_KNOWN = 0.25
"""Of a picture's cells: a membrane that hangs on fewer shows nothing of the scene."""
EDGE = 0.1
"""Step of grey in [0, 1] over which the membrane holds half as well."""
LEAST_OF_GUIDE = 0.25
"""Inverse depths stay above so much of the guide's: differences that are continued may be larger than it."""


def filled(
    surfaces: Sequence[Surface], views: Sequence[GreyView], guides: Sequence[Array] | None = None
) -> list[Surface]:
    """The surfaces with all cells known, of which those that were not have support 0.

    Inverse depth is harmonic between the known cells, which a plane's is; what other pictures know lies around and
    between. Cells that would hide what another picture knows are left unknown, and so are all of a picture of which
    less than a quarter is known.

    Args:
        surfaces: one of each picture.
        views: the pictures.
        guides: (N,) inverse depths for each picture's cells; then what is harmonic is the difference to them, and any
            share of a picture may be unknown.
    """
    xyz = np.concatenate([surface.points(np.flatnonzero(surface.known)) for surface in surfaces])
    guide = [None] * len(surfaces) if guides is None else guides
    guessed = [_filled(*each, xyz) for each in zip(surfaces, views, guide, strict=True)]
    return [_free(index, guessed, surfaces) for index in range(len(surfaces))]


def _filled(surface: Surface, view: GreyView, guide: Array | None, xyz: Array) -> Surface:
    grid = surface.depths.grid
    (rows, columns), pad = grid.shape, round(MARGIN * max(grid.shape)) if guide is None else 0
    inside = (slice(pad, pad + rows), slice(pad, pad + columns))
    known = _others(surface, xyz, pad)
    mine = np.where(surface.known, surface.depths.inverse_depth, 0).reshape(grid.shape)
    known[inside] = np.where(mine > 0, mine, known[inside])
    grey = np.nan_to_num(view.greys[1])[grid.indices].reshape(grid.shape)
    if guide is not None:
        whole = _guided(known, guide.reshape(grid.shape), grey)
    elif np.count_nonzero(known[inside]) < LEAST_KNOWN * len(surface.known):
        return surface
    else:
        whole = _membrane(known, known == 0, np.pad(grey, pad, mode="edge"))[inside]
    scores = np.where(surface.known, surface.depths.scores, 0).astype(np.float32)
    guess = DepthMap.through(grid, whole.ravel(), scores)
    planes = np.where(surface.known[:, None], surface.depths.planes, guess.planes)
    depths = replace(guess, planes=planes)
    return replace(surface, depths=depths, known=np.ones_like(surface.known), support=surface.support * surface.known)


def _others(surface: Surface, xyz: Array, pad: int) -> Array:
    """(R, C) inverse depths of world points on the picture's cells with ``pad`` more on each side, 0 for none."""
    grid = surface.depths.grid
    shape = (grid.shape[0] + 2 * pad, grid.shape[1] + 2 * pad)
    pixels, depth = surface.camera.project(xyz)
    places = np.rint((pixels - 0.5 - grid.pixels[0, :2]) / grid.stride) + pad
    inside = (depth > 0) & (places >= 0).all(axis=1) & (places < shape[::-1]).all(axis=1)
    out = np.zeros(shape)
    columns, rows = places[inside].astype(np.intp).T
    np.maximum.at(out, (rows, columns), 1 / depth[inside])
    return out


def _guided(known: Array, guide: Array, grey: Floats) -> Array:
    """(R, C) the values, those that are 0 such that what they are more than the guide is continued from around."""
    unknown = known == 0
    if unknown.all():
        return guide
    more = _membrane(np.where(unknown, 0, known - guide), unknown, grey)
    return np.where(unknown, np.maximum(guide + more, LEAST_OF_GUIDE * guide), known)


def _membrane(known: Array, unknown: NDArray[np.bool_], grey: Floats) -> Array:
    """(R, C) the values, the unknown ones such that each is the weighted mean of its neighbours."""
    numbers = np.arange(known.size).reshape(known.shape)
    first, second, hold = [], [], []
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        weight = 1 / (1 + ((grey[a] - grey[b]) / EDGE) ** 2)
        first += [numbers[a].ravel(), numbers[b].ravel()]
        second += [numbers[b].ravel(), numbers[a].ravel()]
        hold += [weight.ravel()] * 2
    links = coo_array((np.concatenate(hold), (np.concatenate(first), np.concatenate(second)))).tocsr()
    balance = (diags_array(links.sum(axis=1)) - links).tocsr()
    values = known.ravel().copy()
    free = unknown.ravel()
    if free.any():
        values[free] = spsolve(balance[free][:, free].tocsc(), -(balance[free][:, ~free] @ values[~free]))
    return np.asarray(values.reshape(known.shape), np.float64)


def _free(index: int, guessed: Sequence[Surface], surfaces: Sequence[Surface]) -> Surface:
    """A filled surface without the guesses that would hide what another picture knows."""
    mine = guessed[index]
    cells = np.flatnonzero(mine.known & ~surfaces[index].known)
    xyz = mine.points(cells)
    hiding = np.zeros(len(cells), bool)
    for other in (*surfaces[:index], *surfaces[index + 1 :]):
        hiding |= other.look(xyz).hiding
    known = mine.known.copy()
    known[cells[hiding]] = False
    return replace(mine, known=known)
