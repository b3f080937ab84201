"""Depths of what no two pictures show alike: continued from what is known.

Floors and walls that enclose the scene go on as planes until they meet what stands on them; the rest is continued as
a membrane is spanned by a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import spsolve

from fourd.background.stereo.enclosing_planes import EnclosingPlanes
from fourd.background.stereo.fusion import Surface
from fourd.background.stereo.patches import Floats, GreyView
from fourd.background.stereo.patchmatch import DepthMap

Array = NDArray[np.float64]

MARGIN = 0.25
"""Of the picture's sides: how far beyond them what other pictures know is taken in."""
LEAST_KNOWN = 0.25
"""Of a picture's cells: guesses that are continued from fewer show nothing of the scene."""
LEAST_FRAME = 0.003
"""Of a picture's cells and the margin's, for a membrane to hang on."""
LEAST_REST = 0.005
"""Of the known points, off the enclosing planes; of fewer no membrane is hung where a plane is met."""
FARTHEST = 4.0
"""Of the farthest that a picture knows: a plane is not continued beyond."""
EDGE = 0.1
"""Step of grey in [0, 1] over which the membrane holds half as well."""


def filled(surfaces: Sequence[Surface], views: Sequence[GreyView], seed: int) -> list[Surface]:
    """The surfaces with the cells known that can be guessed; those that were not known have support 0.

    A guess is the nearer of the planes that enclose the scene (``seed`` is of the search for them) and of a membrane:
    inverse depth that is harmonic between the known cells off these planes, as a plane's is. What other pictures know,
    or have guessed before, lies around and between. Cells that would hide what another picture knows are left unknown,
    and so are all of a picture of which less than a quarter is known.
    """
    xyz = np.concatenate([surface.points(np.flatnonzero(surface.known)) for surface in surfaces])
    planes = EnclosingPlanes.of(xyz, [surface.camera for surface in surfaces], np.random.default_rng(seed))
    rest = xyz[~planes.on(xyz)]
    lacking = len(rest) < LEAST_REST * len(xyz)
    if lacking:
        rest = xyz
    sizes = [np.count_nonzero(_off_planes(surface, planes)) for surface in surfaces]
    enough = [_enough(surface, xyz) for surface in surfaces]
    guessed = list(surfaces)
    # Those that know most first: the others continue what these have guessed, and pieces of one wall join.
    for index in np.argsort(sizes, kind="stable")[::-1]:
        if not enough[index]:
            continue
        surface = surfaces[index]
        guessed[index], hung = _filled(surface, views[index], planes, rest, lacking)
        rest = np.concatenate([rest, guessed[index].points(np.flatnonzero(hung))])
    return [without_hiding(index, guessed, surfaces) for index in range(len(surfaces))]


def _enough(surface: Surface, xyz: Array) -> bool:
    """Whether a picture or the others know enough of what it shows."""
    known = surface.known | (others_in(surface, xyz, 0).ravel() > 0)
    return bool(np.count_nonzero(known) >= LEAST_KNOWN * len(known))


def _off_planes(surface: Surface, planes: EnclosingPlanes) -> NDArray[np.bool_]:
    """(N,) the known cells that belong to no plane."""
    cells = np.flatnonzero(surface.known)
    off = np.zeros_like(surface.known)
    off[cells] = ~planes.on(surface.points(cells))
    return off


def _filled(
    surface: Surface, view: GreyView, planes: EnclosingPlanes, rest: Array, lacking: bool
) -> tuple[Surface, NDArray[np.bool_]]:
    """A picture's surface with guesses, and which cells (N,) the membrane has given.

    Where known points off the planes are ``lacking``, ``rest`` are all, and the membrane only takes what no plane does.
    """
    grid = surface.depths.grid
    (rows, columns), pad = grid.shape, round(MARGIN * max(grid.shape))
    inside = (slice(pad, pad + rows), slice(pad, pad + columns))
    frame = others_in(surface, rest, pad)
    off = np.where(_off_planes(surface, planes), surface.depths.inverse_depth, 0).reshape(grid.shape)
    frame[inside] = np.where(off > 0, off, frame[inside])
    flat = planes.inverse_depth(surface.camera, grid).reshape(grid.shape)
    flat[flat < surface.depths.inverse_depth[surface.known].min(initial=np.inf) / FARTHEST] = 0
    hung = np.zeros(grid.shape)
    if np.count_nonzero(frame) > LEAST_FRAME * frame.size:
        grey = np.nan_to_num(view.greys[1])[grid.indices].reshape(grid.shape)
        hung = membrane(frame, frame == 0, np.pad(grey, pad, mode="edge"))[inside]
    known = surface.known.reshape(grid.shape)
    hung = np.where((flat > 0) & lacking, 0, hung)
    whole = np.where(known, surface.depths.inverse_depth.reshape(grid.shape), np.maximum(flat, hung))
    return with_guesses(surface, whole.ravel()), (~known & (hung > flat)).ravel()


def with_guesses(surface: Surface, inverse_depth: Array) -> Surface:
    """The surface with guesses (N,) beside its known cells, of support 0; where they are 0 nothing is known."""
    scores = np.where(surface.known, surface.depths.scores, 0).astype(np.float32)
    guess = DepthMap.through(surface.depths.grid, inverse_depth, scores)
    depths = replace(guess, planes=np.where(surface.known[:, None], surface.depths.planes, guess.planes))
    return replace(surface, depths=depths, known=inverse_depth > 0, support=surface.support * surface.known)


def others_in(surface: Surface, xyz: Array, pad: int) -> Array:
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


def membrane(known: Array, unknown: NDArray[np.bool_], grey: Floats, pull: float = 0.0) -> Array:
    """(R, C) the values, the unknown ones the weighted means of their neighbours, and by ``pull`` of 0."""
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
        system = balance[free][:, free]
        if pull > 0:
            system = system + pull * diags_array(np.ones(system.shape[0]))
        right = -(balance[free][:, ~free] @ values[~free])
        values[free] = spsolve(system.tocsc(), right, permc_spec="MMD_AT_PLUS_A")
    return np.asarray(values.reshape(known.shape), np.float64)


def without_hiding(index: int, guessed: Sequence[Surface], surfaces: Sequence[Surface]) -> Surface:
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
