"""Points on the hull's surface: the centres of cells near the surface are moved onto the surface, and then points are
removed evenly."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fourd.base.cameras import Array
from fourd.reconstruction.carving.hull import Silhouettes, refine, root_cells
from fourd.reconstruction.carving.silhouette import Floats, sample

CANDIDATES = 1.3
"""Number of candidate cells for each requested point. More candidates make the density of the points more even, but the
computation slower."""
MIN_DEPTH = 0.7
"""A move into the hull is acceptable if the moved point's distance from the surface is at least this fraction of the
length of the move. The fraction is below 1, because near a crease, the moved point's distance from the surface is
smaller than the length of the move."""


def surface_cells(views: Silhouettes, lower: Array, upper: Array, size: float) -> Floats:
    """Find the cells of side length ``size`` that may intersect the surface inside a box, and return their centres
    (3, N).

    The search starts with larger cells. Those that may intersect the surface are subdivided repeatedly, until the cells
    have the side length ``size``. These smallest cells are not tested: all of them are returned. The coordinates are
    relative to the origin of ``views``.
    """
    longest = float((upper - lower).max())
    levels = max(0, int(np.log2(max(longest / size / 6, 1))))
    side = size * 2**levels
    cells = root_cells(lower, upper, side)
    for _ in range(levels):
        cells, side = refine(cells[:, views.may_contain_surface(cells, side)], side)
    return cells


def project_to_surface(
    views: Silhouettes, xyz: Floats, distance: Floats, deciding: NDArray[np.int16], size: float
) -> tuple[Floats, Floats]:
    """Move points (3, N) onto the surface along the gradient of the distance. Points that do not converge are dropped.

    The deciding view of a point is the view whose silhouette determines its distance. Two gradient steps are enough,
    except at creases of the surface, where the deciding view changes. A point has converged if its distance to the
    surface is at most a tenth of ``size``.

    Returns:
        points (3, M) and their outward unit normals (3, M).
    """
    for _ in range(2):
        slope = distance_gradient(views, xyz, deciding)
        steps = (distance / np.maximum((slope**2).sum(axis=0), np.float32(0.25))).clip(-size, size)
        xyz = xyz - steps * slope
        distance, deciding = views.distance(xyz)
    converged = np.abs(distance) <= size / 10
    xyz = xyz[:, converged]
    slope = distance_gradient(views, xyz, deciding[converged])
    length = np.maximum(np.sqrt((slope**2).sum(axis=0)), np.float32(1e-6))
    return xyz, -slope / length


def move_inwards(views: Silhouettes, xyz: Floats, normals: Floats, inset: float) -> Floats:
    """Move surface points (N, 3) into the hull, against their outward normals (N, 3).

    A move is acceptable if the moved point's distance from the surface is about the length of the move. Each point
    makes the longest acceptable move: by ``inset``, or in thin parts of the hull by 3/4, 1/2 or 1/4 of ``inset``, or
    not at all.
    """
    moved, remaining = xyz.copy(), np.arange(len(xyz))
    for quarters in (4, 3, 2, 1):
        length = np.float32(inset * quarters / 4)
        tried = xyz[remaining] - length * normals[remaining]
        fits = views.distance(np.ascontiguousarray(tried.T))[0] >= MIN_DEPTH * length
        moved[remaining[fits]] = tried[fits]
        remaining = remaining[~fits]
    return moved


def distance_gradient(views: Silhouettes, xyz: Floats, deciding: NDArray[np.int16]) -> Floats:
    """Return the gradient (3, N) of the signed distance to the deciding view's silhouette at points (3, N), in world
    coordinates.

    The gradient points inwards, and its length is about 1.
    """
    out = np.zeros_like(xyz)
    half = np.float32(0.5)
    for index, view in enumerate(views.views):
        chosen = np.flatnonzero(deciding == index)
        if chosen.size == 0:
            continue
        x, y, _ = view.project(np.ascontiguousarray(xyz[:, chosen]))
        taps_x = np.concatenate([x + half, x - half, x, x])
        taps_y = np.concatenate([y, y, y + half, y - half])
        right, left, down, up = sample(view.distance, taps_x, taps_y, cv2.INTER_LINEAR).reshape(4, -1)
        gradient_x, gradient_y = right - left, down - up
        gradient_z = gradient_x * x + gradient_y * y
        rows = view.matrix
        out[:, chosen] = (
            rows[0][:, None] * gradient_x + rows[1][:, None] * gradient_y - rows[2][:, None] * gradient_z
        ) / np.float32(view.focal)
    return out


def thin_evenly(xyz: NDArray[np.float32], count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Select ``count`` of the points (N, 3) such that their density is even, and return their indices in random order.

    ``count`` is at most N. In each of several rounds, one point of each of the closest pairs is removed. Because the
    order is random, the first M points are a uniform sample for every M.
    """
    kept = np.arange(len(xyz))
    while len(kept) > count:
        surplus = len(kept) - count
        distance, other = cKDTree(xyz[kept], leafsize=12).query(xyz[kept], k=2)
        gap, nearest = np.asarray(distance)[:, 1], np.asarray(other)[:, 1]
        is_kept = (gap[nearest] < gap) | ((gap[nearest] == gap) & (nearest > np.arange(len(kept))))
        order = np.argsort(np.where(is_kept, np.inf, gap), kind="stable")
        drop_count = max(1, min(surplus, int((~is_kept).sum()), len(kept) // 6))
        drop = np.zeros(len(kept), dtype=np.bool_)
        drop[order[:drop_count]] = True
        kept = kept[~drop]
    return rng.permutation(kept)


def choose_cell_side(views: Silhouettes, lower: Array, upper: Array, points: int) -> float:
    """Choose the side length of cells such that the surface in the box intersects CANDIDATES cells per requested point.

    The area of the surface is measured with cells whose side length is 1/64 of the box's longest side. If fewer than
    200 cells are near the surface, the area is measured again with smaller cells. The returned side length is 0 if
    there is no surface.
    """
    side = float((upper - lower).max()) / 64
    for _ in range(3):
        count = views.surface_slab(surface_cells(views, lower, upper, side), side)[0].shape[1]
        if count >= 200:
            break
        side /= 2
    return side * float(np.sqrt(count / (CANDIDATES * points)))
