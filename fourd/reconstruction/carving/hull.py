"""The visual hull as a signed distance function, and the search for cells that may contain its surface.

Each soft matte is converted to a signed distance image in pixels. The distance is positive inside the silhouette and
zero where the bilinearly sampled matte is one half. To compute a world point's signed distance to the silhouette of a
view, the view's distance image is sampled at the projection of the point. The sample is multiplied by depth / focal
length, which converts pixels to world units. The point's signed distance to the hull is the minimum of its distances to
the silhouettes of all views that see the point. If k views may be wrong, the (k + 1)-th smallest distance is used
instead of the minimum.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Array, Camera
from fourd.reconstruction.carving.silhouette import Floats, SilhouetteView, sample

CHUNK = 1 << 15
"""Number of cells that are processed together. A float32 array with one value per cell has 128 KiB, which fits in the
L2 cache."""

SLACK_PIXELS = np.float32(0.75)
"""Tolerance in pixels that is added to the radius of a cell's projection. A cell is classified by comparing this sum
with the signed distance from the projection of the cell's centre to the contour of the silhouette. The tolerance
accounts for the matte's soft edge (0.5 pixels) and for rounding in bilinear sampling."""

SLACK_FACTOR = np.float32(1.03)
"""Factor that multiplies the radius of a cell's projection in pixels, to account for the error of the 5x5 distance
transform, which is up to 2%."""

MIN_VIEWS = 3
"""At least this number of views must see a hull point. Two views are not enough, because the viewing cones of two
silhouettes can intersect where there is no object. If the capture has only two views, both must see the point."""

DIAGONAL = float(np.sqrt(3) / 2)
"""Half the diagonal of a cell, divided by the cell's side length."""


@dataclass(frozen=True, eq=False)
class Silhouettes:
    """All silhouettes of one frame, and the fraction of the views that must agree.

    Attributes:
        origin: (3,) float64 world point. The coordinates of all cells and points are relative to the origin.
        views: the silhouettes in the order of the cameras.
        agreement: a fraction in (0, 1]. A point belongs to the hull only if it is inside the silhouettes of at least
            this fraction of the views that see it.
        needed: minimum number of views that must see a hull point.
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
            ValueError: if the number of masks is below 2 or differs from the number of cameras, a mask and its camera
                differ in size, or ``agreement`` or ``least_views`` is outside (0, 1].
        """
        if len(masks) != len(cameras) or len(masks) < 2:
            raise ValueError(
                f"masks: expected one mask per camera and at least 2, got {len(masks)} masks for {len(cameras)} cameras"
            )
        for name, share in (("agreement", agreement), ("least_views", least_views)):
            if not 0 < share <= 1:
                raise ValueError(f"{name}: expected a share in (0, 1], got {share}")
        views = tuple(SilhouetteView.from_mask(m, c, origin) for m, c in zip(masks, cameras, strict=True))
        needed = max(min(MIN_VIEWS, len(views)), int(np.ceil(least_views * len(views) - 1e-9)))
        return Silhouettes(origin, views, agreement, needed)

    def without(self, index: int) -> Silhouettes:
        """Return a copy without the view ``index``. Its ``needed`` is at most the number of remaining views."""
        remaining = self.views[:index] + self.views[index + 1 :]
        return replace(self, views=remaining, needed=min(self.needed, len(remaining)))

    def tolerated_outliers(self, seen: NDArray[np.integer]) -> NDArray[np.int64]:
        """Return, for each point, the number of views that may be wrong about it: a point of the hull may be outside
        the silhouettes of at most this number of the views that see it. ``seen`` contains the number of views that see
        each point."""
        return np.floor((1 - self.agreement) * np.asarray(seen) + 1e-9).astype(np.int64)

    def may_contain_object(self, cells: Floats, size: float) -> NDArray[np.bool_]:
        """Return a bool array (N,) that is True for cells (3, N) of side length ``size`` that may intersect the object.

        All other cells certainly do not intersect the object.
        """
        return np.concatenate([self._classify(chunk, size)[0] for chunk in chunks(cells)])

    def may_contain_surface(self, cells: Floats, size: float) -> NDArray[np.bool_]:
        """Return a bool array (N,) that is True for cells (3, N) of side length ``size`` that may intersect the
        surface.

        All other cells certainly do not intersect the surface.
        """
        classes = [self._classify(chunk, size) for chunk in chunks(cells)]
        return np.concatenate([maybe & ~inside for maybe, inside in classes])

    def _classify(self, cells: Floats, size: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return two (N,) bool arrays for cells (3, N): whether the cell may intersect the object, and whether it is
        certainly inside the object."""
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
        """Return the signed distance to the hull at points (3, N), and the deciding view of each point. The silhouette
        of the deciding view determines the distance.

        Returns:
            distance: (N,) distance in world units, positive inside, or -inf if too few views see the point.
            deciding: (N,) index of the view whose silhouette gives the distance, or -1 if too few views see the point.
        """
        parts = [self._rank_views(chunk, np.inf) for chunk in chunks(xyz)]
        return np.concatenate([part[1] for part in parts]), np.concatenate([part[2] for part in parts])

    def surface_slab(self, cells: Floats, size: float) -> tuple[Floats, Floats, NDArray[np.int16]]:
        """Select the cells (3, N) of side length ``size`` whose centres are at most ``size / 2`` from the surface.

        The selected centres fill a slab of thickness ``size`` around the surface. For any slope of the surface, the
        slab contains on average one centre per ``size ** 2`` of surface area, so the number of selected cells is
        proportional to the surface's area.

        Returns:
            the selected cell centres (3, M), and for each centre the distance and the deciding view, as
            :meth:`distance` returns them.
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
        """Compute the signed distance to the hull and the deciding view (see :meth:`distance`) for each of the points
        ``xyz`` (3, N). Points that lie outside the hull by more than ``outside`` are dropped.

        Returns:
            indices of the remaining points, their signed distances to the hull, and their deciding views.
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
    """Return the signed distances of points (3, N) to the silhouette of one view.

    Returns:
        distances (N,) in world units, positive inside, and a bool array (N,) that is True for points that the view
        sees.
    """
    x, y, z = view.project(xyz)
    value = sample(view.distance, x, y, cv2.INTER_LINEAR)
    value *= z
    value /= np.float32(view.focal)
    return value, view.sees(x, y, z)


def root_cells(lower: Array, upper: Array, size: float) -> Floats:
    """Return the centres (3, N) float32 of cubes of side length ``size`` that cover a box. The grid of cubes is centred
    on the box."""
    counts = np.maximum(1, np.ceil((upper - lower) / size - 1e-6)).astype(int)
    middle = (lower + upper) / 2
    axes = [middle[i] + (np.arange(counts[i]) - (counts[i] - 1) / 2) * size for i in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij")).reshape(3, -1).astype(np.float32)


def refine(cells: Floats, size: float) -> tuple[Floats, float]:
    """Subdivide each cell into eight cells. Return the new centres (3, 8 N), in which the eight parts of a cell are
    adjacent columns, and the new side length."""
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), dtype=np.float32)
    steps = corners.reshape(3, 1, 8) * np.float32(size / 4)
    return (cells[:, :, None] + steps).reshape(3, -1), size / 2


def chunks(cells: Floats) -> Iterator[Floats]:
    """Yield the columns of ``cells`` (3, N) in chunks of at most CHUNK columns. If N is 0, yield one empty chunk."""
    for begin in range(0, max(cells.shape[1], 1), CHUNK):
        yield np.ascontiguousarray(cells[:, begin : begin + CHUNK])


def interleaved_order(count: int) -> list[int]:
    """Return the camera indices 0 to count - 1 in an order for processing the views one after another.

    The order is made for cameras that are numbered along a ring: indices that follow each other in the returned list
    belong to cameras that are far apart in the ring. The first few processed views then reject most cells, because they
    look from very different directions.
    """
    return sorted(range(count), key=lambda index: (index * 0.6180339887) % 1)


def _count_view(view: SilhouetteView, cells: Floats, radius: np.float32, counts: NDArray[np.int16]) -> None:
    """Classify the circumscribed sphere of each cell in one view, and update the counters ``counts`` (5, N) in place.
    The spheres have the centres ``cells`` (3, N) and the radius ``radius``.

    For each sphere, each row of ``counts`` contains the number of views that satisfy one condition:
    - row 0: the whole sphere is in the image and projects only to background;
    - row 1: the whole sphere is in the image and projects only to the object;
    - row 2: the whole sphere is in the image;
    - row 3: a part of the sphere may be in the image;
    - row 4: a part of the sphere may be in the image, and a part may project to the object.

    Row 4 is needed for spheres at the image borders of many views. A view that sees only a part of such a sphere is
    never counted in row 0, so row 0 alone cannot reject the sphere. The sphere is also rejected if too few views are
    counted in row 4.
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
    """Insert ``value`` (N,), the values of the view ``index``, into ``lowest`` (K, N), in place. Each column of
    ``lowest`` contains the K lowest values so far, in ascending order. ``owners`` (K, N) is also updated in place. It
    contains the index of the view from which each of these values comes."""
    owner = np.full(value.shape, index, dtype=np.int16)
    for rank in range(lowest.shape[0]):
        less = value < lowest[rank]
        lowest[rank], value = np.where(less, value, lowest[rank]), np.where(less, lowest[rank], value)
        owners[rank], owner = np.where(less, owner, owners[rank]), np.where(less, owners[rank], owner)
