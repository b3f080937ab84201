"""Agreement of mattes with the visual hull: the fraction of each matte that the visual hull of the other views covers.

The measure needs no ground truth. Silhouette coherence (Hernandez et al. 2007) compares the silhouette of each view
with the silhouette of the visual hull of all views. This module instead compares each matte with the hull of the other
views. If a matte covers more than the object, the hull of the other views does not cover the whole matte, so this
matte's fraction is low. If a matte lacks a part of the object, the hulls that use it also lack this part, so the
fractions of all other mattes are low.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.reconstruction.carving.bounds import candidate_cells, viewing_region
from fourd.reconstruction.carving.hull import Silhouettes, refine, view_distance
from fourd.reconstruction.carving.silhouette import Floats

Flags = NDArray[np.bool_]

MAX_CELLS = 40_000
"""The hull's cells are subdivided repeatedly, until there are more cells than this number."""
MAX_MATTE_CELLS = 150_000
"""The same limit for hulls whose silhouettes become mattes."""
HULL_AGREEMENT = 0.95
HULL_LEAST_VIEWS = 1 / 2
THRESHOLD = 128


@dataclass(frozen=True, eq=False)
class FrameCoherence:
    """Agreement of the mattes of one frame with the visual hull. For views with an empty matte, all values except
    ``area`` are NaN.

    Attributes:
        explained: (C,) fraction of each view's matte that is inside the silhouette of the hull of the other views.
        kept: (C,) fraction of each view's matte that is inside the silhouette of the hull of all views.
        overlap: (C,) intersection over union of each view's matte and the silhouette of the hull of all views.
        area: (C,) fraction of the image that each matte covers; 0 for an empty matte.
    """

    explained: NDArray[np.float64]
    kept: NDArray[np.float64]
    overlap: NDArray[np.float64]
    area: NDArray[np.float64]


def frame_coherence(
    masks: Sequence[NDArray[np.uint8]],
    cameras: Sequence[Camera],
    *,
    agreement: float = 0.95,
    least_views: float = 1 / 2,
) -> FrameCoherence:
    """Compare the mattes of one frame with the silhouettes of two kinds of visual hulls: the hull of all views, and,
    for each view, the hull of all other views.

    All hulls consist of cubic cells of the same size. First, the cells are subdivided until at least
    :data:`~fourd.reconstruction.carving.bounds.COARSE_CELLS` of them span the object's longest side. If there are then
    at most MAX_CELLS cells, they are subdivided further, until there are more.

    Args:
        masks: mattes (H, W) uint8, one per camera; 255 is the object. At least 2 mattes are required.
        cameras: undistorted pinhole cameras.
        agreement: a fraction in (0, 1]. A point belongs to the hull only if it is inside the mattes of at least this
            fraction of the views that see it.
        least_views: a fraction in (0, 1]. A point belongs to the hull only if it is seen by at least this fraction of
            all views and by at least 3 views. If there are only 2 views, both must see it.
    """
    focus, reach = viewing_region(cameras)
    views = Silhouettes.from_masks(masks, cameras, focus, agreement=agreement, least_views=least_views)
    # The candidate cells must also contain each hull that is computed with one view left out. A cell of such a hull can
    # be outside the silhouettes of some views (the tolerated outliers), and also outside that of the left-out view. A
    # candidate cell may therefore be outside ``rejecting`` silhouettes, one more than the number of tolerated outliers.
    count = len(views.views)
    rejecting = int(views.tolerated_outliers(np.array(count))) + 1
    cells, size = candidate_cells(replace(views, agreement=max(0.5, 1 - rejecting / count)), 1.5 * reach)
    while 0 < cells.shape[1] <= MAX_CELLS:
        cells, size = refine(cells, size)
    seen, outside = _votes(views, cells, size)
    shares, area = np.full((3, len(masks)), np.nan), np.zeros(len(masks))
    hull = _is_hull(views, seen.sum(axis=0), outside.sum(axis=0))
    for index, mask in enumerate(masks):
        matte = mask >= THRESHOLD
        if not matte.any():
            continue
        area[index] = matte.mean()
        others = _is_hull(views.without(index), seen.sum(axis=0) - seen[index], outside.sum(axis=0) - outside[index])
        whole = _silhouette(cells[:, hull] + focus[:, None], size, cameras[index])
        rest = _silhouette(cells[:, others] + focus[:, None], size, cameras[index])
        pixels = np.count_nonzero(matte)
        shares[:, index] = (
            np.count_nonzero(matte & rest) / pixels,
            np.count_nonzero(matte & whole) / pixels,
            np.count_nonzero(matte & whole) / np.count_nonzero(matte | whole),
        )
    return FrameCoherence(shares[0], shares[1], shares[2], area)


def hull_silhouettes(
    masks: Sequence[NDArray[np.uint8]], cameras: Sequence[Camera], targets: Sequence[Camera]
) -> list[NDArray[np.uint8]]:
    """Return mattes (H, W) uint8, 255 = object, of the cameras ``targets``: the silhouettes of the visual hull.

    A matte covers the object and more, because the hull contains the object. The fewer views there are, the more it
    covers.

    Args:
        masks: mattes (H, W) uint8 of one frame, one per camera; 255 is the object. At least 3 mattes are required.
        cameras: undistorted pinhole cameras of the masks.
        targets: undistorted pinhole cameras without masks.
    """
    focus, reach = viewing_region(cameras)
    views = Silhouettes.from_masks(masks, cameras, focus, agreement=HULL_AGREEMENT, least_views=HULL_LEAST_VIEWS)
    cells, size = candidate_cells(views, 1.5 * reach)
    while 0 < cells.shape[1] <= MAX_MATTE_CELLS:
        cells, size = refine(cells[:, views.may_contain_object(cells, size)], size)
    seen, outside = _votes(views, cells, size)
    hull = cells[:, _is_hull(views, seen.sum(axis=0), outside.sum(axis=0))] + focus[:, None]
    return [np.where(_silhouette(hull, size, target), np.uint8(255), np.uint8(0)) for target in targets]


def _votes(views: Silhouettes, cells: Floats, size: float) -> tuple[Flags, Flags]:
    """Return two boolean arrays (C, N) with an element for each view and each cell: whether the view sees the cell's
    centre, and whether the view's silhouette excludes the cell."""
    seen = np.zeros((len(views.views), cells.shape[1]), np.bool_)
    outside = np.zeros_like(seen)
    for index, view in enumerate(views.views):
        if cells.shape[1] == 0:
            break
        distance, seen[index] = view_distance(view, cells)
        outside[index] = seen[index] & (distance < 0)
    return seen, outside


def _is_hull(views: Silhouettes, seen: NDArray[np.int64], outside: NDArray[np.int64]) -> Flags:
    return np.asarray((seen >= views.needed) & (outside <= views.tolerated_outliers(seen)), np.bool_)


def _silhouette(xyz: NDArray[np.float64], size: float, camera: Camera) -> Flags:
    """Return the silhouette (H, W) in ``camera`` of the cells that have the centres ``xyz`` (3, N) and the side length
    ``size``."""
    picture = np.zeros((camera.height, camera.width), np.uint8)
    if xyz.shape[1] == 0:
        return picture > 0
    position, depth = camera.project(xyz.T)
    column, row = np.floor(position[:, 0]), np.floor(position[:, 1])
    sees = (depth > 0) & (column >= 0) & (row >= 0) & (column < camera.width) & (row < camera.height)
    if not sees.any():
        return picture > 0
    picture[row[sees].astype(np.intp), column[sees].astype(np.intp)] = 1
    # Morphological closing fills the gaps between the projected centres of neighbouring cells.
    width = int(np.ceil(1.5 * camera.intrinsics[1, 1] * size / float(np.median(depth[sees])))) | 1
    square = np.ones((width, width), np.uint8)
    return np.asarray(cv2.morphologyEx(picture, cv2.MORPH_CLOSE, square) > 0)
