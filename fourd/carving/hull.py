"""The visual hull as a signed distance, and the cells that may contain its surface.

Each soft matte becomes a signed distance image (pixels, positive inside) that is zero where
the bilinearly sampled matte is one half. The distance of a world point in a view is this
value times depth / focal length. The distance to the hull is an order statistic over the
views that see the point: the minimum if all must agree, or the (k + 1)-th smallest if k
views may be wrong. Views that do not see a point do not count.
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
"""Cells processed at once: their arrays of 128 kB stay in the L2 cache."""

SLACK_PIXELS = np.float32(0.75)
"""Added to a cell's radius when it is classified by its centre: the matte's ramp (0.5) and bilinear rounding."""

SLACK_FACTOR = np.float32(1.03)
"""The 5x5 distance transform has errors of up to 2%."""

MIN_VIEWS = 3
"""Two views rarely prove a surface: any two silhouettes intersect wherever their rays do."""

DIAGONAL = float(np.sqrt(3) / 2)
"""Ratio of half the diagonal of a cell to its side."""


@dataclass(frozen=True, eq=False)
class Silhouettes:
    """All silhouettes of one frame, and how many of them may disagree.

    Attributes:
        origin: (3,) float64 world point; all cells and points are relative to it.
        views: the silhouettes, in the order of the cameras.
        agreement: minimum share in (0, 1] of silhouettes that contain a point, among the views that see it.
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
        """Build the silhouettes of ``masks`` as seen by ``cameras``.

        Raises:
            ValueError: if the counts differ, a mask's size is not its camera's, there are fewer
                than two views, or a share is outside (0, 1].
        """
        if len(masks) != len(cameras) or len(masks) < 2:
            raise ValueError(f"masks: expected one per camera and at least 2, got {len(masks)} for {len(cameras)}")
        for name, share in (("agreement", agreement), ("least_views", least_views)):
            if not 0 < share <= 1:
                raise ValueError(f"{name}: expected a share in (0, 1], got {share}")
        views = tuple(SilhouetteView.from_mask(m, c, origin) for m, c in zip(masks, cameras, strict=True))
        needed = max(min(MIN_VIEWS, len(views)), int(np.ceil(least_views * len(views) - 1e-9)))
        return Silhouettes(origin, views, agreement, needed)

    def without(self, index: int) -> Silhouettes:
        """The same views except one; ``needed`` stays, up to the number of remaining views."""
        remaining = self.views[:index] + self.views[index + 1 :]
        return replace(self, views=remaining, needed=min(self.needed, len(remaining)))

    def tolerated_outliers(self, seen: NDArray[np.integer]) -> NDArray[np.int64]:
        """Number of the ``seen`` views that may disagree, elementwise."""
        return np.floor((1 - self.agreement) * np.asarray(seen) + 1e-9).astype(np.int64)

    def may_contain_object(self, cells: Floats, size: float) -> NDArray[np.bool_]:
        """(N,) bool: which cells (3, N) of side ``size`` may intersect the object. False is certain."""
        return np.concatenate([self._classify(chunk, size)[0] for chunk in chunks(cells)])

    def may_contain_surface(self, cells: Floats, size: float) -> NDArray[np.bool_]:
        """(N,) bool: which cells (3, N) of side ``size`` may intersect the surface. False is certain."""
        classes = [self._classify(chunk, size) for chunk in chunks(cells)]
        return np.concatenate([maybe & ~inside for maybe, inside in classes])

    def _classify(self, cells: Floats, size: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Per cell (3, N): whether it may intersect the object, and whether it lies certainly inside."""
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
        """Signed distance to the hull at points (3, N), and the view that determines it.

        Returns:
            distance (N,) in world units, positive inside, -inf where too few views see the point;
            deciding (N,) index of the view owners silhouette gives the distance, -1 where too few views see the point.
        """
        parts = [self._rank_views(chunk, np.inf) for chunk in chunks(xyz)]
        return np.concatenate([part[1] for part in parts]), np.concatenate([part[2] for part in parts])

    def surface_slab(self, cells: Floats, size: float) -> tuple[Floats, Floats, NDArray[np.int16]]:
        """Select the cells (3, N) owners centres lie within half a side of the surface.

        A slab as thick as a cell contains one centre per squared side of surface at any
        slope of the surface. The count therefore measures area, and the density is even.

        Returns:
            the cell centres (3, M), and the two results of :meth:`distance` for them.
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
        """Indices of the points (3, N) at most ``outside`` outside the surface, their distances and deciding views."""
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
    """Signed distance (N,) of one view in world units at points (3, N), and whether the view sees them (N,)."""
    x, y, z = view.project(xyz)
    value = sample(view.distance, x, y, cv2.INTER_LINEAR)
    value *= z
    value /= np.float32(view.focal)
    return value, view.sees(x, y, z)


def root_cells(lower: Array, upper: Array, size: float) -> Floats:
    """Centres (3, N) float32 of cubes of side ``size`` that cover the box; the grid is centred on the box."""
    counts = np.maximum(1, np.ceil((upper - lower) / size - 1e-6)).astype(int)
    middle = (lower + upper) / 2
    axes = [middle[i] + (np.arange(counts[i]) - (counts[i] - 1) / 2) * size for i in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij")).reshape(3, -1).astype(np.float32)


def refine(cells: Floats, size: float) -> tuple[Floats, float]:
    """The eight children (3, 8 N) of each cell, siblings adjacent, and their side."""
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), dtype=np.float32)
    steps = corners.reshape(3, 1, 8) * np.float32(size / 4)
    return (cells[:, :, None] + steps).reshape(3, -1), size / 2


def chunks(cells: Floats) -> Iterator[Floats]:
    """The columns of ``cells`` (3, N) in contiguous chunks of CHUNK; one empty chunk if N is 0."""
    for begin in range(0, max(cells.shape[1], 1), CHUNK):
        yield np.ascontiguousarray(cells[:, begin : begin + CHUNK])


def interleaved_order(count: int) -> list[int]:
    """0 .. count - 1 in an order whose successive indices are far apart on a ring of cameras.

    Views from different angles reject most cells, so early rejection needs few views.
    """
    return sorted(range(count), key=lambda index: (index * 0.6180339887) % 1)


def _count_view(view: SilhouetteView, cells: Floats, radius: np.float32, counts: NDArray[np.int16]) -> None:
    """Add one view's classification of spheres of ``radius`` around ``cells`` (3, N) to ``counts`` (5, N).

    The rows count the views in which the sphere is: fully seen and all background, fully seen
    and all object, fully seen, possibly partly seen, possibly partly seen and partly object.
    The last row rejects spheres that many image borders cut: no view sees all of such a
    sphere, but the seen part is background.
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
    """Insert ``value`` (N,) of view ``index`` into the ascending lists ``lowest`` (K, N), in place."""
    owner = np.full(value.shape, index, dtype=np.int16)
    for rank in range(lowest.shape[0]):
        less = value < lowest[rank]
        lowest[rank], value = np.where(less, value, lowest[rank]), np.where(less, lowest[rank], value)
        owners[rank], owner = np.where(less, owner, owners[rank]), np.where(less, owners[rank], owner)
