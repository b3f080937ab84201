"""Depth completion: extrapolate depths into depth-map cells that stereo does not measure.

Floors and walls that enclose the scene are extended as planes until they meet other surfaces. In the remaining cells,
inverse depth is interpolated harmonically: each cell gets the weighted mean of its neighbours' values.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import spsolve

from fourd.reconstruction.background.surfaces.enclosing_planes import EnclosingPlanes
from fourd.recording.stereo.fusion import Surface
from fourd.recording.stereo.patches import Floats, GreyView
from fourd.recording.stereo.patchmatch import DepthMap

Array = NDArray[np.float64]

MARGIN = 0.25
"""Width of a margin around an image, as a fraction of the image's longer side. The interpolation also uses points of
other images that project into this margin."""
MIN_KNOWN = 0.25
"""Minimum fraction of known cells in an image. Below it, depths are not extrapolated, because they would not resemble
the scene."""
MIN_BOUNDARY = 0.003
"""Minimum fraction of cells with known values, counted over the image and its margin. Below it, inverse depth is not
interpolated."""
MIN_OFF_PLANE = 0.005
"""Minimum fraction of known points that lie off the enclosing planes. Below it, interpolated depths are used only for
cells whose ray hits no plane."""
MAX_DEPTH_FACTOR = 4.0
"""Maximum depth of an extended plane, as a multiple of the largest known depth in the image."""
EDGE_SCALE = 0.1
"""Difference of two neighbouring cells' grey values, in [0, 1], at which the interpolation weight between them is one
half."""


def complete_surfaces(surfaces: Sequence[Surface], views: Sequence[GreyView], seed: int) -> list[Surface]:
    """Complete surfaces: extrapolate depths into their unknown cells, which have no depth yet.

    A completed depth is the minimum of an interpolated depth and the depth of the nearest enclosing plane. The
    interpolated depth comes from harmonic interpolation of inverse depth, which is exact for planar surfaces. The
    interpolation starts from two kinds of cells with fixed values: known cells that lie on no enclosing plane, and
    cells that contain projections of points that are known or interpolated in other images.

    A cell remains unknown if it would occlude a known surface of another image. If less than a quarter of an image's
    cells are known, none of its unknown cells is completed. Completed cells have support 0, because no other image
    confirms them.

    Args:
        surfaces: one surface per image.
        views: the images. Interpolation weights are lower across edges in the images.
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
    # Images are completed in descending order of the number of known cells that lie on no enclosing plane (floor or
    # wall). The interpolated points of each image are used as fixed values when later images are interpolated, so that
    # surfaces agree between images.
    for index in np.argsort(sizes, kind="stable")[::-1]:
        if not enough[index]:
            continue
        surface = surfaces[index]
        completed[index], interpolated = _complete(surface, views[index], planes, off_plane, prefers_planes)
        off_plane = np.concatenate([off_plane, completed[index].points(np.flatnonzero(interpolated))])
    return [remove_occluding(index, completed, surfaces) for index in range(len(surfaces))]


def _has_enough_known(surface: Surface, xyz: Array) -> bool:
    """Return true if enough cells of an image are known or contain projections of the points ``xyz`` (N, 3)."""
    known = surface.known | (project_inverse_depths(surface, xyz, 0).ravel() > 0)
    return bool(np.count_nonzero(known) >= MIN_KNOWN * len(known))


def _off_planes(surface: Surface, planes: EnclosingPlanes) -> NDArray[np.bool_]:
    """Return an (N,) bool mask of the cells that have a depth and whose world point lies on no enclosing plane."""
    cells = np.flatnonzero(surface.known)
    off = np.zeros_like(surface.known)
    off[cells] = ~planes.contains(surface.points(cells))
    return off


def _complete(
    surface: Surface, view: GreyView, planes: EnclosingPlanes, xyz: Array, prefers_planes: bool
) -> tuple[Surface, NDArray[np.bool_]]:
    """Extrapolate depths into the unknown cells of one image's surface.

    Args:
        surface: the image's surface.
        view: the image.
        planes: enclosing planes.
        xyz: (M, 3) world points that are used for harmonic interpolation.
        prefers_planes: whether interpolated depths are used only for cells whose ray hits no plane.

    Returns:
        the completed surface, and a mask (N,) of the cells with an interpolated depth.
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
    harmonic = np.zeros(grid.shape)
    if np.count_nonzero(boundary) > MIN_BOUNDARY * boundary.size:
        grey = np.nan_to_num(view.greys[1])[grid.indices].reshape(grid.shape)
        harmonic = interpolate_inverse_depths(boundary, boundary == 0, np.pad(grey, pad, mode="edge"))[inside]
    known = surface.known.reshape(grid.shape)
    harmonic = np.where((plane_inverse > 0) & prefers_planes, 0, harmonic)
    whole = np.where(known, surface.depths.inverse_depth.reshape(grid.shape), np.maximum(plane_inverse, harmonic))
    return with_completed_depths(surface, whole.ravel()), (~known & (harmonic > plane_inverse)).ravel()


def with_completed_depths(surface: Surface, inverse_depth: Array) -> Surface:
    """Set the inverse depths (N,) of a surface's unknown cells, and set the support of these cells to 0. Cells with
    inverse depth 0 stay unknown."""
    scores = np.where(surface.known, surface.depths.scores, 0).astype(np.float32)
    completed = DepthMap.from_inverse_depth(surface.depths.grid, inverse_depth, scores)
    depths = replace(completed, planes=np.where(surface.known[:, None], surface.depths.planes, completed.planes))
    return replace(surface, depths=depths, known=inverse_depth > 0, support=surface.support * surface.known)


def project_inverse_depths(surface: Surface, xyz: Array, pad: int) -> Array:
    """Compute the largest inverse depth (R, C) of the world points that project into each cell, or 0 for cells without
    points.

    The result extends ``pad`` cells beyond the depth map on each side.
    """
    grid = surface.depths.grid
    shape = (grid.shape[0] + 2 * pad, grid.shape[1] + 2 * pad)
    pixels, depth = surface.camera.project(xyz)
    positions = np.rint((pixels - 0.5 - grid.pixels[0, :2]) / grid.stride) + pad
    inside = (depth > 0) & (positions >= 0).all(axis=1) & (positions < shape[::-1]).all(axis=1)
    out = np.zeros(shape)
    columns, rows = positions[inside].astype(np.intp).T
    np.maximum.at(out, (rows, columns), 1 / depth[inside])
    return out


def interpolate_inverse_depths(
    known: Array, unknown: NDArray[np.bool_], grey: Floats, zero_weight: float = 0.0
) -> Array:
    """Interpolate harmonically: each unknown cell (R, C) gets the weighted mean of its neighbours' values.

    The weights are lower across edges in the image ``grey``. Each mean also includes the value 0, with the weight
    ``zero_weight``.
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
    """Remove those completed cells of a surface that would occlude known surfaces of other images."""
    surface = completed[index]
    cells = np.flatnonzero(surface.known & ~surfaces[index].known)
    xyz = surface.points(cells)
    occludes = np.zeros(len(cells), bool)
    for other in (*surfaces[:index], *surfaces[index + 1 :]):
        occludes |= other.project(xyz).occludes
    known = surface.known.copy()
    known[cells[occludes]] = False
    return replace(surface, known=known)
