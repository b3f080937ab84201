"""Depth completion: extrapolation of depths to cells that stereo does not measure.

Floors and walls that enclose the scene are extended as planes until they meet other surfaces. The remaining cells are
interpolated with a membrane, the harmonic interpolation of inverse depth.
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
"""Width of the border around a picture in which other pictures' points are used, relative to its longer side."""
MIN_KNOWN = 0.25
"""Minimum share of known cells; extrapolation from fewer does not resemble the scene."""
MIN_BOUNDARY = 0.003
"""Minimum share of a picture's and its margin's cells that constrain the membrane."""
MIN_OFF_PLANE = 0.005
"""Minimum share of known points off the enclosing planes; with fewer the membrane is not used where a plane is met."""
MAX_DEPTH_FACTOR = 4.0
"""Planes are extended to this multiple of the farthest known depth of a picture."""
EDGE_SCALE = 0.1
"""Grey difference in [0, 1] at which the membrane's smoothness weight drops to one half."""


def complete_surfaces(surfaces: Sequence[Surface], views: Sequence[GreyView], seed: int) -> list[Surface]:
    """Complete the unknown cells of surfaces; completed cells have support 0.

    A completed depth is the nearer of the enclosing planes and a membrane. The membrane is the harmonic interpolation
    of inverse depth between known cells off these planes, which is exact for planar surfaces. Points known or completed
    in other pictures constrain it too. Cells that would occlude a known surface of another picture stay unknown, as do
    pictures with less than a quarter of known cells.

    Args:
        surfaces: one per picture.
        views: the pictures; grey edges weaken the membrane.
        seed: random seed of the search for planes.
    """
    xyz = np.concatenate([surface.points(np.flatnonzero(surface.known)) for surface in surfaces])
    planes = EnclosingPlanes.from_points(xyz, [surface.camera for surface in surfaces], np.random.default_rng(seed))
    off_plane = xyz[~planes.contains(xyz)]
    prefers_planes = len(off_plane) < MIN_OFF_PLANE * len(xyz)
    if prefers_planes:
        off_plane = xyz
    sizes = [np.count_nonzero(_off_planes(surface, planes)) for surface in surfaces]
    enough = [_has_enough_known(surface, xyz) for surface in surfaces]
    completed = list(surfaces)
    # Pictures with most known cells first: the others continue their completed depths, so that walls join.
    for index in np.argsort(sizes, kind="stable")[::-1]:
        if not enough[index]:
            continue
        surface = surfaces[index]
        completed[index], interpolated = _complete(surface, views[index], planes, off_plane, prefers_planes)
        off_plane = np.concatenate([off_plane, completed[index].points(np.flatnonzero(interpolated))])
    return [remove_occluding(index, completed, surfaces) for index in range(len(surfaces))]


def _has_enough_known(surface: Surface, xyz: Array) -> bool:
    """Whether enough of a picture's cells are known in it or covered by the points (N, 3) of all pictures."""
    known = surface.known | (project_inverse_depths(surface, xyz, 0).ravel() > 0)
    return bool(np.count_nonzero(known) >= MIN_KNOWN * len(known))


def _off_planes(surface: Surface, planes: EnclosingPlanes) -> NDArray[np.bool_]:
    """(N,) bool: the known cells that lie on no enclosing plane."""
    cells = np.flatnonzero(surface.known)
    off = np.zeros_like(surface.known)
    off[cells] = ~planes.contains(surface.points(cells))
    return off


def _complete(
    surface: Surface, view: GreyView, planes: EnclosingPlanes, xyz: Array, prefers_planes: bool
) -> tuple[Surface, NDArray[np.bool_]]:
    """A picture's completed surface, and the cells (N,) that were interpolated by the membrane.

    The points ``xyz`` (M, 3) constrain the membrane. With ``prefers_planes`` it is used only where no plane is met.
    """
    grid = surface.depths.grid
    (rows, columns), pad = grid.shape, round(MARGIN * max(grid.shape))
    inside = (slice(pad, pad + rows), slice(pad, pad + columns))
    boundary = project_inverse_depths(surface, xyz, pad)
    off = np.where(_off_planes(surface, planes), surface.depths.inverse_depth, 0).reshape(grid.shape)
    boundary[inside] = np.where(off > 0, off, boundary[inside])
    plane_inverse = planes.inverse_depth(surface.camera, grid).reshape(grid.shape)
    plane_inverse[
        plane_inverse < surface.depths.inverse_depth[surface.known].min(initial=np.inf) / MAX_DEPTH_FACTOR
    ] = 0
    membrane = np.zeros(grid.shape)
    if np.count_nonzero(boundary) > MIN_BOUNDARY * boundary.size:
        grey = np.nan_to_num(view.greys[1])[grid.indices].reshape(grid.shape)
        membrane = interpolate_membrane(boundary, boundary == 0, np.pad(grey, pad, mode="edge"))[inside]
    known = surface.known.reshape(grid.shape)
    membrane = np.where((plane_inverse > 0) & prefers_planes, 0, membrane)
    whole = np.where(known, surface.depths.inverse_depth.reshape(grid.shape), np.maximum(plane_inverse, membrane))
    return with_completed_depths(surface, whole.ravel()), (~known & (membrane > plane_inverse)).ravel()


def with_completed_depths(surface: Surface, inverse_depth: Array) -> Surface:
    """The surface with completed inverse depths (N,) in its unknown cells, with support 0; 0 means unknown."""
    scores = np.where(surface.known, surface.depths.scores, 0).astype(np.float32)
    completed = DepthMap.from_inverse_depth(surface.depths.grid, inverse_depth, scores)
    depths = replace(completed, planes=np.where(surface.known[:, None], surface.depths.planes, completed.planes))
    return replace(surface, depths=depths, known=inverse_depth > 0, support=surface.support * surface.known)


def project_inverse_depths(surface: Surface, xyz: Array, pad: int) -> Array:
    """(R, C) largest inverse depth of world points per cell, with ``pad`` more cells on each side; 0 without points."""
    grid = surface.depths.grid
    shape = (grid.shape[0] + 2 * pad, grid.shape[1] + 2 * pad)
    pixels, depth = surface.camera.project(xyz)
    positions = np.rint((pixels - 0.5 - grid.pixels[0, :2]) / grid.stride) + pad
    inside = (depth > 0) & (positions >= 0).all(axis=1) & (positions < shape[::-1]).all(axis=1)
    out = np.zeros(shape)
    columns, rows = positions[inside].astype(np.intp).T
    np.maximum.at(out, (rows, columns), 1 / depth[inside])
    return out


def interpolate_membrane(known: Array, unknown: NDArray[np.bool_], grey: Floats, zero_weight: float = 0.0) -> Array:
    """Interpolate unknown cells (R, C) as the weighted mean of their neighbours.

    Weights drop across grey edges. ``zero_weight`` is the weight of a zero value in each mean.
    """
    numbers = np.arange(known.size).reshape(known.shape)
    first, second, weights = [], [], []
    for a, b in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        weight = 1 / (1 + ((grey[a] - grey[b]) / EDGE_SCALE) ** 2)
        first += [numbers[a].ravel(), numbers[b].ravel()]
        second += [numbers[b].ravel(), numbers[a].ravel()]
        weights += [weight.ravel()] * 2
    links = coo_array((np.concatenate(weights), (np.concatenate(first), np.concatenate(second)))).tocsr()
    laplacian = (diags_array(links.sum(axis=1)) - links).tocsr()
    values = known.ravel().copy()
    free = unknown.ravel()
    if free.any():
        system = laplacian[free][:, free]
        if zero_weight > 0:
            system = system + zero_weight * diags_array(np.ones(system.shape[0]))
        right = -(laplacian[free][:, ~free] @ values[~free])
        values[free] = spsolve(system.tocsc(), right, permc_spec="MMD_AT_PLUS_A")
    return np.asarray(values.reshape(known.shape), np.float64)


def remove_occluding(index: int, completed: Sequence[Surface], surfaces: Sequence[Surface]) -> Surface:
    """A completed surface without the completed cells that would occlude a known surface of another picture."""
    surface = completed[index]
    cells = np.flatnonzero(surface.known & ~surfaces[index].known)
    xyz = surface.points(cells)
    occludes = np.zeros(len(cells), bool)
    for other in (*surfaces[:index], *surfaces[index + 1 :]):
        occludes |= other.project(xyz).occludes
    known = surface.known.copy()
    known[cells[occludes]] = False
    return replace(surface, known=known)
