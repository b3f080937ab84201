"""Points on the hull's surface: candidates from the cells, moved onto it, thinned to an even spread."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fourd.cameras import Array
from fourd.carving.hull import Silhouettes, refine, root_cells
from fourd.carving.silhouette import Floats, sample

CANDIDATES = 1.3
"""Candidates for each wanted point: what thinning needs to choose from, and what projection costs."""


def surface_cells(views: Silhouettes, lower: Array, upper: Array, size: float) -> Floats:
    """Centres (3, N) of cells of side ``size``, all that may hold surface inside the box among them.

    The cells come from halving larger ones, of which only those survive that may hold
    surface; the last are not judged. The box is relative to the origin of ``views``.
    """
    longest = float((upper - lower).max())
    levels = max(0, int(np.log2(max(longest / size / 6, 1))))
    side = size * 2**levels
    cells = root_cells(lower, upper, side)
    for _ in range(levels):
        cells, side = refine(cells[:, views.may_hold_surface(cells, side)], side)
    return cells


def project(
    views: Silhouettes, xyz: Floats, distance: Floats, deciding: NDArray[np.int16], size: float
) -> tuple[Floats, Floats]:
    """Move points (3, N) onto the surface along the gradient; drop those that do not arrive.

    Two steps settle all but creases, where another view takes over; a point arrives when
    it is within a tenth of ``size`` of the surface.

    Returns:
        xyz (3, M) and outward unit normals (3, M).
    """
    for _ in range(2):
        slope = gradient(views, xyz, deciding)
        steps = (distance / np.maximum((slope**2).sum(axis=0), np.float32(0.25))).clip(-size, size)
        xyz = xyz - steps * slope
        distance, deciding = views.distance(xyz)
    arrived = np.abs(distance) <= size / 10
    xyz = xyz[:, arrived]
    slope = gradient(views, xyz, deciding[arrived])
    length = np.maximum(np.sqrt((slope**2).sum(axis=0)), np.float32(1e-6))
    return xyz, -slope / length


def gradient(views: Silhouettes, xyz: Floats, deciding: NDArray[np.int16]) -> Floats:
    """World gradient (3, N) of the deciding view's distance at points (3, N), about unit length inwards."""
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
        along_x, along_y = right - left, down - up
        toward = along_x * x + along_y * y
        rows = view.matrix
        out[:, chosen] = (
            rows[0][:, None] * along_x + rows[1][:, None] * along_y - rows[2][:, None] * toward
        ) / np.float32(view.focal)
    return out


def thin(xyz: NDArray[np.float32], count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Indices of ``count`` of the points (N, 3), N >= count, evenly spread, in random order.

    Of the closest pairs one point goes, round by round. The random order makes every
    prefix a fair sample of the whole.
    """
    kept = np.arange(len(xyz))
    while len(kept) > count:
        surplus = len(kept) - count
        distance, other = cKDTree(xyz[kept], leafsize=12).query(xyz[kept], k=2)
        gap, nearest = distance[:, 1], other[:, 1]
        loser = (gap[nearest] < gap) | ((gap[nearest] == gap) & (nearest > np.arange(len(kept))))
        order = np.argsort(np.where(loser, np.inf, gap), kind="stable")
        most = max(1, min(surplus, int((~loser).sum()), len(kept) // 6))
        drop = np.zeros(len(kept), dtype=np.bool_)
        drop[order[:most]] = True
        kept = kept[~drop]
    return rng.permutation(kept)


def cell_side(views: Silhouettes, lower: Array, upper: Array, points: int) -> float:
    """The side of cells at which the surface inside the box has CANDIDATES cells for each point.

    Measured as the surface's area on cells of 1/64 of the box, or smaller ones when it has
    few of those; 0 when there is no surface.
    """
    side = float((upper - lower).max()) / 64
    for _ in range(3):
        count = views.slab(surface_cells(views, lower, upper, side), side)[0].shape[1]
        if count >= 200:
            break
        side /= 2
    return side * float(np.sqrt(count / (CANDIDATES * points)))
