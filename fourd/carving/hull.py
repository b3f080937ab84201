"""The visual hull as a signed distance, and a search for the cells that may contain its surface.

Each soft matte is converted to a signed distance image in pixels. The distance is positive inside the silhouette and
zero where the bilinearly sampled matte is one half. In one view, a world point's distance to the silhouette is the
image's value at the point's projection times depth / focal length, in world units. The distance to the hull is an order
statistic over the views that see the point. It is the minimum if all views must agree, or the (k + 1)-th smallest
distance if k views may be wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Array, Camera
from fourd.carving.silhouette import Floats, SilhouetteView, sample

CHUNK = 1 << 15
"""Number of cells that are processed together, so that each array has 128 kB and stays in the L2 cache."""

SLACK_PIXELS = np.float32(0.75)
"""Tolerance in pixels that is added to a cell's radius when the cell is classified by the distance at its centre. The
tolerance covers the matte's soft edge (0.5 pixels) and the rounding of bilinear sampling."""

SLACK_FACTOR = np.float32(1.03)
"""Factor on a cell's radius in pixels when the cell is classified. It covers the error of the 5x5 distance transform,
up to 2%."""

MIN_VIEWS = 3
"""Minimum number of views that must see a point. Two views are not enough, because any two silhouettes whose rays
intersect have a common volume."""

DIAGONAL = float(np.sqrt(3) / 2)
"""Ratio of half the diagonal of a cell to its side."""


@dataclass(frozen=True, eq=False)
class Silhouettes:
    """All silhouettes of one frame, and how many of them may disagree.

    Attributes:
        origin: (3,) float64 world point; the coordinates of all cells and points are relative to this point.
        views: the silhouettes in the order of the cameras.
        agreement: share in (0, 1]. A point is in the hull if at least this share of the views that see it have it
            inside their silhouettes.
        needed: minimum number of views that must see a point.
    """

    origin: Array
    views: tuple[SilhouetteView, ...]
    agreement: float
    needed: int

    @staticmethod
    def from_masks(
        masks: Sequence[NDArray[np.uint8]],
        cameras: Sequence[Camera],
        origin: Array,
        *,
        agreement: float,
        least_views: float,
    ) -> Silhouettes:
        """Build the silhouettes from ``masks`` and their ``cameras``.

        Raises:
            ValueError: if the numbers of masks and cameras differ, a mask and its camera differ in size, there are
                fewer than two views, or a share is outside (0, 1].
        """
        if len(masks) != len(cameras) or len(masks) < 2:
            raise ValueError(
                f"masks: expected one per camera and at least 2, got {len(masks)} masks for {len(cameras)} cameras"
            )
        for name, share in (("agreement", agreement), ("least_views", least_views)):
            if not 0 < share <= 1:
                raise ValueError(f"{name}: expected a share in (0, 1], got {share}")
        views = tuple(SilhouetteView.from_mask(m, c, origin) for m, c in zip(masks, cameras, strict=True))
        needed = max(min(MIN_VIEWS, len(views)), int(np.ceil(least_views * len(views) - 1e-9)))
        return Silhouettes(origin, views, agreement, needed)

    def without(self, index: int) -> Silhouettes:
        """Remove one view; ``needed`` is reduced to the number of remaining views if it exceeds this number."""
        remaining = self.views[:index] + self.views[index + 1 :]
        return replace(self, views=remaining, needed=min(self.needed, len(remaining)))

    def tolerated_outliers(self, seen: NDArray[np.integer]) -> NDArray[np.int64]:
        """Number of views that may have a point outside their silhouettes if ``seen`` views see the point;
        elementwise."""
        return np.floor((1 - self.agreement) * np.asarray(seen) + 1e-9).astype(np.int64)

    def may_contain_object(self, cells: Floats, size: float) -> NDArray[np.bool_]:
        """(N,) bool: whether a cell (3, N) of side ``size`` may intersect the object; if False, it certainly does
        not."""
        return np.concatenate([self._classify(chunk, size)[0] for chunk in chunks(cells)])

    def may_contain_surface(self, cells: Floats, size: float) -> NDArray[np.bool_]:
        """(N,) bool: whether a cell (3, N) of side ``size`` may intersect the surface; if False, it certainly does
        not."""
        classes = [self._classify(chunk, size) for chunk in chunks(cells)]
        return np.concatenate([maybe & ~inside for maybe, inside in classes])

    def _classify(self, cells: Floats, size: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Two (N,) bool arrays: whether a cell (3, N) may intersect the object, and whether it is certainly inside."""
        maybe = np.zeros(cells.shape[1], dtype=np.bool_)
        inside = np.zeros(cells.shape[1], dtype=np.bool_)
        alive = np.arange(cells.shape[1])
        counts = np.zeros((5, cells.shape[1]), dtype=np.int16)
        max_outside = int(self.tolerated_outliers(np.array(len(self.views))))
        for number, index in enumerate(interleaved_order(len(self.views))):
            _count_view(self.views[index], cells, np.float32(size * DIAGONAL), counts)
            if number % 3 == 2:
                keep = np.flatnonzero(counts[0] <= max_outside)
                cells, counts, alive = cells[:, keep], counts[:, keep], alive[keep]
        outside, contained, fully_seen, partly_seen, partly_object = counts
        min_object = self.needed - int(self.tolerated_outliers(np.array(self.needed)))
        enough = (partly_seen >= self.needed) & (partly_object >= min_object)
        maybe[alive] = enough & (outside <= self.tolerated_outliers(partly_seen))
        inside[alive] = (partly_seen - contained <= self.tolerated_outliers(fully_seen)) & (fully_seen >= self.needed)
        return maybe, inside

    def distance(self, xyz: Floats) -> tuple[Floats, NDArray[np.int16]]:
        """Signed distance to the hull at points (3, N), and the view that determines this distance.

        Returns:
            distance: (N,) distance in world units, positive inside; -inf if too few views see the point.
            deciding: (N,) index of the view whose silhouette gives the distance; -1 if too few views see the point.
        """
        parts = [self._rank_views(chunk, np.inf) for chunk in chunks(xyz)]
        return np.concatenate([part[1] for part in parts]), np.concatenate([part[2] for part in parts])

    def surface_slab(self, cells: Floats, size: float) -> tuple[Floats, Floats, NDArray[np.int16]]:
        """Select the cells (3, N) of side ``size`` whose centres are at most ``size / 2`` from the surface.

        At any slope of the surface, a slab of this thickness contains on average one cell centre per ``size ** 2`` of
        surface area. The number of cells therefore measures the area, and their density is even.

        Returns:
            the cell centres (3, M), and their distances and deciding views as in :meth:`distance`.
        """
        kept, distance, deciding = [], [], []
        for chunk in chunks(cells):
            index, value, view = self._rank_views(chunk, size / 2)
            near = value <= size / 2
            kept.append(chunk[:, index[near]])
            distance.append(value[near])
            deciding.append(view[near])
        return np.concatenate(kept, axis=1), np.concatenate(distance), np.concatenate(deciding)

    def _rank_views(self, xyz: Floats, outside: float) -> tuple[NDArray[np.int64], Floats, NDArray[np.int16]]:
        """Compute distances and deciding views of points (3, N); drop points outside the hull by more than ``outside``.

        Returns:
            the indices of the remaining points, their distances, and their deciding views.
        """
        kept = int(self.tolerated_outliers(np.array(len(self.views)))) + 1
        lowest = np.full((kept, xyz.shape[1]), np.inf, dtype=np.float32)
        owners = np.full((kept, xyz.shape[1]), -1, dtype=np.int16)
        seen = np.zeros(xyz.shape[1], dtype=np.int16)
        alive = np.arange(xyz.shape[1])
        for number, index in enumerate(interleaved_order(len(self.views))):
            value, sees = view_distance(self.views[index], xyz)
            seen += sees
            value[~sees] = np.inf
            _insert(lowest, owners, value, np.int16(index))
            if number % 3 == 2 and outside < np.inf:
                keep = np.flatnonzero(lowest[-1] >= -outside)
                xyz, lowest, owners, seen, alive = (
                    xyz[:, keep],
                    lowest[:, keep],
                    owners[:, keep],
                    seen[keep],
                    alive[keep],
                )
        rank = self.tolerated_outliers(seen)[None]
        distance = np.take_along_axis(lowest, rank, axis=0)[0]
        deciding = np.take_along_axis(owners, rank, axis=0)[0]
        unknown = seen < self.needed
        distance[unknown] = -np.inf
        deciding[unknown] = -1
        if outside < np.inf:
            near = np.flatnonzero(distance >= -outside)
            return alive[near], distance[near], deciding[near]
        return alive, distance, deciding


def view_distance(view: SilhouetteView, xyz: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Signed distances (N,) of points (3, N) in one view in world units, and (N,) bool, whether the view sees them."""
    x, y, z = view.project(xyz)
    value = sample(view.distance, x, y, cv2.INTER_LINEAR)
    value *= z
    value /= np.float32(view.focal)
    return value, view.sees(x, y, z)


def root_cells(lower: Array, upper: Array, size: float) -> Floats:
    """Centres (3, N) float32 of cubes of side ``size`` that cover a box; the grid of cubes is centred on the box."""
    counts = np.maximum(1, np.ceil((upper - lower) / size - 1e-6)).astype(int)
    middle = (lower + upper) / 2
    axes = [middle[i] + (np.arange(counts[i]) - (counts[i] - 1) / 2) * size for i in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij")).reshape(3, -1).astype(np.float32)


def refine(cells: Floats, size: float) -> tuple[Floats, float]:
    """Subdivide each cell into eight; return the centres (3, 8 N), with siblings next to each other, and the side."""
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), dtype=np.float32)
    steps = corners.reshape(3, 1, 8) * np.float32(size / 4)
    return (cells[:, :, None] + steps).reshape(3, -1), size / 2


def chunks(cells: Floats) -> Iterator[Floats]:
    """Yield the columns of ``cells`` (3, N) in contiguous chunks of CHUNK columns; one empty chunk if N is 0."""
    for begin in range(0, max(cells.shape[1], 1), CHUNK):
        yield np.ascontiguousarray(cells[:, begin : begin + CHUNK])


def interleaved_order(count: int) -> list[int]:
    """The numbers 0 to count - 1 in an order in which successive cameras of a ring are far apart.

    In this order, the first few views come from different angles and reject most cells.
    """
    return sorted(range(count), key=lambda index: (index * 0.6180339887) % 1)


def _count_view(view: SilhouetteView, cells: Floats, radius: np.float32, counts: NDArray[np.int16]) -> None:
    """Classify spheres of ``radius`` around ``cells`` (3, N) in one view and add the result to ``counts`` (5, N).

    Each row of ``counts`` counts views. Row 0: the whole sphere is in the image and projects only to background. Row 1:
    the whole sphere is in the image and projects only to the object. Row 2: the whole sphere is in the image. Row 3: a
    part of the sphere may be in the image. Row 4: as row 3, and a part may project to the object. Row 4 is needed for
    spheres that are cut by many image borders. Row 0 counts no view for such a sphere, even if all its visible parts
    are background.
    """
    x, y, z = view.project(cells)
    in_front = z > radius * np.float32(1.001)
    radius_px = np.float32(view.reach) * radius / np.where(in_front, z - radius, np.float32(np.inf))
    border = view.border_distance(x, y)
    fully_seen = in_front & (border >= radius_px)
    distance = sample(view.distance, x, y, cv2.INTER_LINEAR)
    needed = radius_px * SLACK_FACTOR + SLACK_PIXELS
    background = in_front & (distance < -needed)
    partly_seen = (in_front & (border >= -radius_px)) | ((z > -radius) & ~in_front)
    counts[0] += fully_seen & background
    counts[1] += fully_seen & (distance > needed)
    counts[2] += fully_seen
    counts[3] += partly_seen
    counts[4] += partly_seen & ~background


def _insert(lowest: Floats, owners: NDArray[np.int16], value: Floats, index: np.int16) -> None:
    """Insert the values (N,) of view ``index`` in place into the ascending columns of ``lowest`` (K, N)."""
    owner = np.full(value.shape, index, dtype=np.int16)
    for rank in range(lowest.shape[0]):
        less = value < lowest[rank]
        lowest[rank], value = np.where(less, value, lowest[rank]), np.where(less, lowest[rank], value)
        owners[rank], owner = np.where(less, owner, owners[rank]), np.where(less, owners[rank], owner)
