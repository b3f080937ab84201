"""Estimation of the scene's bounding box from the cameras and the masks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Array, Camera
from fourd.base.errors import UserError
from fourd.base.progress import Track, untracked
from fourd.reconstruction.carving.hull import Silhouettes, refine, root_cells, view_distance
from fourd.recording.capture.layout import sample_indices
from fourd.recording.capture.pictures.mask_source import MaskSource, frame_masks

COARSE_CELLS = 48
"""Number of grid cells along the longest side of the visual hull's bounding box. The box is measured with an error of
at most one cell, which is 2% of its longest side and therefore less than the default margin."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """An axis-aligned box in world units.

    Attributes:
        lower: (3,) float64 corner with the smallest coordinates.
        upper: (3,) float64 corner with the largest coordinates; greater than ``lower`` on every axis.

    Raises:
        ValueError: if a corner is not three finite numbers or the box is empty.
    """

    lower: Array
    upper: Array

    def __post_init__(self) -> None:
        for name in ("lower", "upper"):
            corner = np.array(getattr(self, name), dtype=np.float64)
            if corner.shape != (3,) or not np.isfinite(corner).all():
                raise ValueError(f"{name}: expected three finite numbers, got {corner.tolist()}")
            corner.flags.writeable = False
            object.__setattr__(self, name, corner)
        if not (self.upper > self.lower).all():
            raise ValueError(f"upper: expected more than lower {self.lower.tolist()}, got {self.upper.tolist()}")

    @property
    def centre(self) -> Array:
        """(3,) centre of the box."""
        return (self.lower + self.upper) / 2

    @property
    def extent(self) -> Array:
        """(3,) side lengths in world units."""
        return self.upper - self.lower

    def union(self, other: Bounds) -> Bounds:
        """Return the smallest box that contains both this box and the box ``other``."""
        return Bounds(np.minimum(self.lower, other.lower), np.maximum(self.upper, other.upper))

    def padded(self, share: float) -> Bounds:
        """Return the box with each face moved outwards by ``share`` times the longest side."""
        pad = share * float(self.extent.max())
        return Bounds(self.lower - pad, self.upper + pad)

    def contains(self, xyz: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
        """Return a bool array (N,) that is True for points ``xyz`` (N, 3) that are inside the box."""
        return np.all((xyz >= self.lower) & (xyz <= self.upper), axis=1)


def find_bounds(
    capture: MaskSource,
    *,
    agreement: float = 0.95,
    least_views: float = 1 / 2,
    margin: float = 0.05,
    max_frames: int = 120,
    track: Track = untracked,
) -> Bounds:
    """Find a box that contains the visual hulls of the capture's frames, and add a margin.

    Args:
        capture: cameras and masks; frames are read one at a time.
        agreement: a fraction in (0, 1]. A point belongs to the hull only if it is inside the silhouettes of at least
            this fraction of the views that see it.
        least_views: a fraction in (0, 1]. A point belongs to the hull only if it is seen by at least this fraction of
            all views and by at least 3 views. If there are only 2 views, both must see it.
        margin: distance by which each face of the box is moved outwards, as a fraction of the box's longest side.
        max_frames: maximum number of frames that are read. They are evenly spaced and include the first and the last
            frame.
        track: callback that reports progress.

    Raises:
        UserError: if the hull of a frame is empty. The message names the 3 views that disagree most with the others;
            see :func:`removed_shares`.
    """
    frames = sample_indices(capture.frame_count, max_frames)
    box: Bounds | None = None
    for frame in track(frames, len(frames), "bounds"):
        hull = hull_bounds(
            frame_masks(capture, frame),
            capture.cameras,
            agreement=agreement,
            least_views=least_views,
            names=capture.names,
            label=f"{capture.path} frame {capture.frame_numbers[frame]}",
        )
        box = hull if box is None else box.union(hull)
    if box is None:
        raise UserError(f"{capture.path}: expected at least one frame, got none; choose other --frames")
    return box.padded(margin)


def hull_bounds(
    masks: Sequence[NDArray[np.uint8]],
    cameras: Sequence[Camera],
    *,
    agreement: float = 0.95,
    least_views: float = 1 / 2,
    names: Sequence[str] | None = None,
    label: str = "masks",
) -> Bounds:
    """Find the bounding box of the visual hull of one frame, without a margin.

    The error of the box is at most 2% of its longest side. The search starts in a cube that contains all cameras and is
    centred on the point nearest to all optical axes. The cube is enlarged if the hull touches its faces.

    Raises:
        UserError: if the hull is empty. The message names the 3 views that disagree most with the others; see
            :func:`removed_shares`.
    """
    focus, reach = viewing_region(cameras)
    views = Silhouettes.from_masks(masks, cameras, focus, agreement=agreement, least_views=least_views)
    for half in (1.5 * reach, 3 * reach, 6 * reach):
        cells, size = candidate_cells(views, half)
        if cells.shape[1] == 0:
            break
        lower = cells.min(axis=1) - size / 2
        upper = cells.max(axis=1) + size / 2
        if max(-float(lower.min()), float(upper.max())) < half - size:
            break
    if cells.shape[1] == 0:
        raise empty_hull_error(views, 1.5 * reach, names, label)
    return Bounds(focus + lower, focus + upper)


def viewing_region(cameras: Sequence[Camera]) -> tuple[Array, float]:
    """Find the point (3,) nearest to all optical axes, and the distance between this point and the farthest camera.

    If the optical axes are almost parallel, many points are almost equally near to them. The result is then determined
    by a weak prior for a point in front of the cameras. Let c be the mean of the camera centres, and d the distance
    between c and the camera farthest from c. The prior's point is at the distance 4 * d from c, in the mean viewing
    direction. If the axes are not parallel, the prior has almost no effect, because its weight is only 0.1% of the
    weight of the axes.
    """
    centres = np.stack([camera.centre for camera in cameras])
    axes = np.stack([camera.forward for camera in cameras])
    middle = centres.mean(axis=0)
    spread = float(np.linalg.norm(centres - middle, axis=1).max())
    mean_axis = axes.mean(axis=0)
    prior = middle + 4 * spread * mean_axis / max(float(np.linalg.norm(mean_axis)), 1e-9) * (
        np.linalg.norm(mean_axis) > 0.5
    )
    projectors = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    prior_weight = 1e-3 * len(cameras)
    matrix = projectors.sum(axis=0) + prior_weight * np.eye(3)
    focus = np.linalg.solve(matrix, np.einsum("vij,vj->i", projectors, centres) + prior_weight * prior)
    return focus, max(float(np.linalg.norm(centres - focus, axis=1).max()), 1e-6)


def empty_hull_error(views: Silhouettes, half: float, names: Sequence[str] | None, label: str) -> UserError:
    """Create the error for an empty hull.

    The message names the three views with the largest :func:`removed_shares`. ``half`` is half the side of the search
    cube in world units.
    """
    labels = list(names) if names is not None else [f"view {i}" for i in range(len(views.views))]
    blank = [name for name, view in zip(labels, views.views, strict=True) if view.distance.max() < 0]
    if len(blank) == len(labels):
        return UserError(
            f"{label}: expected an object in the masks, got none in any view; choose other frames or masks"
        )
    shares = removed_shares(views, half)
    worst = sorted(range(len(labels)), key=lambda i: (-shares[i], i))[:3]
    removals = ", ".join(f"{labels[i]} (removes {100 * shares[i]:.0f}% of the other views' hull)" for i in worst)
    return UserError(
        f"{label}: expected a visual hull with an agreement of {views.agreement:g}, got an empty hull; "
        f"these views disagree most: {removals}; fix the masks or the calibration of these views, exclude the views, "
        "or pass a lower --agreement to fourd carve"
    )


def removed_shares(views: Silhouettes, half: float) -> list[float]:
    """Compute, for each view, how large a fraction in [0, 1] the view removes from the hull of all other views.

    A point belongs to a hull if it is inside the silhouettes of a large enough fraction of the views that see it. This
    fraction is the agreement. The hull of the other views is computed with an agreement of 1. If this hull is empty,
    the agreement is lowered in steps, to 0.5 at the lowest, until the hull is not empty. The search cube is centred on
    the origin of ``views``, and ``half`` is half the cube's side in world units.
    """
    shares = []
    for index, view in enumerate(views.views):
        others = views.without(index)
        cells = np.zeros((3, 0), dtype=np.float32)
        for agreement in (1.0, 0.9, 0.8, 0.65, 0.5):
            cells, _ = candidate_cells(replace(others, agreement=agreement), half)
            if cells.shape[1]:
                break
        distance, sees = view_distance(view, cells)
        shares.append(float(np.mean(sees & (distance < 0))) if cells.shape[1] else 0.0)
    return shares


def candidate_cells(views: Silhouettes, half: float) -> tuple[NDArray[np.float32], float]:
    """Find the grid cells that may contain the object.

    The cells are subdivided until the longest side of their common bounding box is at least COARSE_CELLS cells long, or
    until a cell's side is below ``half / 4096``. ``half`` is half the side of the search cube in world units.

    Returns:
        centres (3, N) of the cells, and the side length of a cell in world units.
    """
    size = half / 4
    cells = root_cells(np.full(3, -half), np.full(3, half), size)
    while cells.shape[1]:
        cells = cells[:, views.may_contain_object(cells, size)]
        if cells.shape[1] == 0:
            break
        extent = float((cells.max(axis=1) - cells.min(axis=1)).max()) + size
        if extent / size >= COARSE_CELLS or size < half / 4096:
            break
        cells, size = refine(cells, size)
    return cells, size
