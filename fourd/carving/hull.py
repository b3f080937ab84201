"""The visual hull as a signed distance, and the cells that may hold its surface.

Each soft matte is a signed distance image (pixels, positive inside) whose zero lies where
the matte, sampled bilinearly, is one half. A world point's distance in a view is that
times depth / focal length. The hull's distance is an order statistic over the views that
see the point: where all must agree it is the minimum, and where a share is enough it is
the (k + 1)-th smallest, so that k views may be wrong. Views that do not see a point abstain.
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
"""Cells worked on at once: their arrays of 128 kB stay in the second-level cache."""

SLACK_PIXELS = np.float32(0.75)
"""Kept clear when a cell is judged by its centre: the matte's ramp (0.5) and bilinear rounding."""

SLACK_SHARE = np.float32(1.03)
"""The 5x5 distance transform is off by up to 2%."""

FEWEST_VIEWS = 3
"""What two views alone see is mostly no surface: any two silhouettes meet wherever their rays do."""

DIAGONAL = float(np.sqrt(3) / 2)
"""Half diagonal of a cell over its side."""


@dataclass(frozen=True, eq=False)
class Silhouettes:
    """All views of one frame and how many of them may disagree.

    Attributes:
        origin: (3,) float64 world point that all cells and points here are relative to.
        views: the silhouettes, in the order of the cameras.
        agreement: share in (0, 1] of the seeing views that must hold a point.
        needed: number of views that must see a point.
    """

    origin: Array
    views: tuple[SilhouetteView, ...]
    agreement: float
    needed: int

    @staticmethod
    def of(
        masks: Sequence[NDArray[np.uint8]],
        cameras: Sequence[Camera],
        origin: Array,
        *,
        agreement: float,
        least_views: float,
    ) -> Silhouettes:
        """The views of ``masks`` by ``cameras``.

        Raises:
            ValueError: when the counts differ, a mask has another size, there are fewer
                than two views, or a share is outside (0, 1].
        """
        if len(masks) != len(cameras) or len(masks) < 2:
            raise ValueError(f"masks: expected one per camera and at least 2, got {len(masks)} for {len(cameras)}")
        for name, share in (("agreement", agreement), ("least_views", least_views)):
            if not 0 < share <= 1:
                raise ValueError(f"{name}: expected a share in (0, 1], got {share}")
        views = tuple(SilhouetteView.of(m, c, origin) for m, c in zip(masks, cameras, strict=True))
        needed = max(min(FEWEST_VIEWS, len(views)), int(np.ceil(least_views * len(views) - 1e-9)))
        return Silhouettes(origin, views, agreement, needed)

    def without(self, index: int) -> Silhouettes:
        """The same views but for one; as many must see a point as before, or all that are left."""
        left = self.views[:index] + self.views[index + 1 :]
        return replace(self, views=left, needed=min(self.needed, len(left)))

    def tolerated(self, seen: NDArray[np.integer]) -> NDArray[np.int64]:
        """How many of ``seen`` views may disagree, elementwise."""
        return np.floor((1 - self.agreement) * np.asarray(seen) + 1e-9).astype(np.int64)

    def may_hold(self, cells: Floats, size: float) -> NDArray[np.bool_]:
        """Which cells (3, N) of side ``size`` may hold a part of the object. False is certain."""
        return np.concatenate([self._judge(chunk, size)[0] for chunk in chunks(cells)])

    def may_hold_surface(self, cells: Floats, size: float) -> NDArray[np.bool_]:
        """Which cells (3, N) of side ``size`` may hold a part of the surface. False is certain."""
        judged = [self._judge(chunk, size) for chunk in chunks(cells)]
        return np.concatenate([maybe & ~inside for maybe, inside in judged])

    def _judge(self, cells: Floats, size: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Per cell (3, N): may it hold a part of the object, and is it certainly all inside."""
        maybe = np.zeros(cells.shape[1], dtype=np.bool_)
        inside = np.zeros(cells.shape[1], dtype=np.bool_)
        alive = np.arange(cells.shape[1])
        tally = np.zeros((5, cells.shape[1]), dtype=np.int16)
        most = int(self.tolerated(np.array(len(self.views))))
        for number, index in enumerate(spread_order(len(self.views))):
            _count_verdict(self.views[index], cells, np.float32(size * DIAGONAL), tally)
            if number % 3 == 2:
                keep = np.flatnonzero(tally[0] <= most)
                cells, tally, alive = cells[:, keep], tally[:, keep], alive[keep]
        against, held, surely, possibly, agreeable = tally
        least = self.needed - int(self.tolerated(np.array(self.needed)))
        enough = (possibly >= self.needed) & (agreeable >= least)
        maybe[alive] = enough & (against <= self.tolerated(possibly))
        inside[alive] = (possibly - held <= self.tolerated(surely)) & (surely >= self.needed)
        return maybe, inside

    def distance(self, xyz: Floats) -> tuple[Floats, NDArray[np.int16]]:
        """Signed distance to the hull at points (3, N), and the view that decides it.

        Returns:
            distance (N,) in world units, positive inside, -inf where too few views see the point;
            deciding (N,) index of the view whose silhouette it is, -1 where too few see it.
        """
        parts = [self._ranked(chunk, np.inf) for chunk in chunks(xyz)]
        return np.concatenate([part[1] for part in parts]), np.concatenate([part[2] for part in parts])

    def slab(self, cells: Floats, size: float) -> tuple[Floats, Floats, NDArray[np.int16]]:
        """The cells (3, N) whose centres lie within half a side of the surface.

        A slab as thick as a cell holds one centre per squared side of surface, whatever the
        surface's slope: their count measures area, and their spread is even.

        Returns:
            their centres (3, M), and for these what :meth:`distance` gives.
        """
        kept, distance, deciding = [], [], []
        for chunk in chunks(cells):
            index, value, view = self._ranked(chunk, size / 2)
            near = value <= size / 2
            kept.append(chunk[:, index[near]])
            distance.append(value[near])
            deciding.append(view[near])
        return np.concatenate(kept, axis=1), np.concatenate(distance), np.concatenate(deciding)

    def _ranked(self, xyz: Floats, outside: float) -> tuple[NDArray[np.int64], Floats, NDArray[np.int16]]:
        """Indices of the points (3, N) at most ``outside`` beyond the surface, their distances and views."""
        kept = int(self.tolerated(np.array(len(self.views)))) + 1
        lowest = np.full((kept, xyz.shape[1]), np.inf, dtype=np.float32)
        whose = np.full((kept, xyz.shape[1]), -1, dtype=np.int16)
        seen = np.zeros(xyz.shape[1], dtype=np.int16)
        alive = np.arange(xyz.shape[1])
        for number, index in enumerate(spread_order(len(self.views))):
            value, sees = view_distance(self.views[index], xyz)
            seen += sees
            value[~sees] = np.inf
            _insert(lowest, whose, value, np.int16(index))
            if number % 3 == 2 and outside < np.inf:
                keep = np.flatnonzero(lowest[-1] >= -outside)
                xyz, lowest, whose, seen, alive = xyz[:, keep], lowest[:, keep], whose[:, keep], seen[keep], alive[keep]
        rank = self.tolerated(seen)[None]
        distance = np.take_along_axis(lowest, rank, axis=0)[0]
        deciding = np.take_along_axis(whose, rank, axis=0)[0]
        unknown = seen < self.needed
        distance[unknown] = -np.inf
        deciding[unknown] = -1
        if outside < np.inf:
            near = np.flatnonzero(distance >= -outside)
            return alive[near], distance[near], deciding[near]
        return alive, distance, deciding


def view_distance(view: SilhouetteView, xyz: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """One view's signed distance (N,) in world units at points (3, N), and whether it sees them (N,)."""
    x, y, z = view.project(xyz)
    value = sample(view.distance, x, y, cv2.INTER_LINEAR)
    value *= z
    value /= np.float32(view.focal)
    return value, view.sees(x, y, z)


def root_cells(lower: Array, upper: Array, size: float) -> Floats:
    """Centres (3, N) float32 of cubes of side ``size`` that cover the box, centred on it."""
    counts = np.maximum(1, np.ceil((upper - lower) / size - 1e-6)).astype(int)
    middle = (lower + upper) / 2
    axes = [middle[i] + (np.arange(counts[i]) - (counts[i] - 1) / 2) * size for i in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij")).reshape(3, -1).astype(np.float32)


def refine(cells: Floats, size: float) -> tuple[Floats, float]:
    """The eight children (3, 8 N) of each cell, siblings side by side, and their side."""
    corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), dtype=np.float32)
    steps = corners.reshape(3, 1, 8) * np.float32(size / 4)
    return (cells[:, :, None] + steps).reshape(3, -1), size / 2


def chunks(cells: Floats) -> Iterator[Floats]:
    """The columns of ``cells`` (3, N) in contiguous runs of CHUNK; one empty run when N is 0."""
    for begin in range(0, max(cells.shape[1], 1), CHUNK):
        yield np.ascontiguousarray(cells[:, begin : begin + CHUNK])


def spread_order(count: int) -> list[int]:
    """0 .. count - 1 so that neighbours in the order are far apart on a ring of cameras.

    Cells are dropped after a few views, and views from unlike angles drop most.
    """
    return sorted(range(count), key=lambda index: (index * 0.6180339887) % 1)


def _count_verdict(view: SilhouetteView, cells: Floats, radius: np.float32, tally: NDArray[np.int16]) -> None:
    """Add one view's word on spheres of ``radius`` about ``cells`` (3, N) to ``tally`` (5, N).

    The rows count the views that certainly see the whole sphere before background, certainly
    see it all within the object, certainly see all of it, possibly see a part of it, and
    possibly see a part of it within the object. The last settles spheres that many images'
    borders cut: no view sees all of them, yet what is seen is background.
    """
    x, y, z = view.project(cells)
    clear = z > radius * np.float32(1.001)
    reach = np.float32(view.reach) * radius / np.where(clear, z - radius, np.float32(np.inf))
    border = view.border(x, y)
    surely = clear & (border >= reach)
    distance = sample(view.distance, x, y, cv2.INTER_LINEAR)
    needed = reach * SLACK_SHARE + SLACK_PIXELS
    background = clear & (distance < -needed)
    possibly = (clear & (border >= -reach)) | ((z > -radius) & ~clear)
    tally[0] += surely & background
    tally[1] += surely & (distance > needed)
    tally[2] += surely
    tally[3] += possibly
    tally[4] += possibly & ~background


def _insert(lowest: Floats, whose: NDArray[np.int16], value: Floats, index: np.int16) -> None:
    """Insert ``value`` (N,) of view ``index`` into the ascending lists ``lowest`` (K, N), in place."""
    owner = np.full(value.shape, index, dtype=np.int16)
    for rank in range(lowest.shape[0]):
        less = value < lowest[rank]
        lowest[rank], value = np.where(less, value, lowest[rank]), np.where(less, lowest[rank], value)
        whose[rank], owner = np.where(less, owner, whose[rank]), np.where(less, whose[rank], owner)
