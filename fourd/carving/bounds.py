"""The box that holds the scene, found from the cameras and the masks alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Array, Camera
from fourd.capture.layout import evenly_spread
from fourd.carving.hull import Silhouettes, refine, root_cells, view_distance
from fourd.carving.mask_source import MaskSource, frame_masks
from fourd.errors import UserError
from fourd.progress import Track, untracked

COARSE_CELLS = 48
"""Cells along the hull's longest side at which its box is taken: 2% of the side, under the margin."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """An axis-aligned box in world units.

    Attributes:
        lower: (3,) float64, the corner of the smallest coordinates.
        upper: (3,) float64, the corner of the largest; greater than ``lower`` on every axis.

    Raises:
        ValueError: when a corner is not three finite numbers or the box is empty.
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
        """(3,) middle of the box."""
        return (self.lower + self.upper) / 2

    @property
    def extent(self) -> Array:
        """(3,) side lengths in world units."""
        return self.upper - self.lower

    def union(self, other: Bounds) -> Bounds:
        """The smallest box that holds both."""
        return Bounds(np.minimum(self.lower, other.lower), np.maximum(self.upper, other.upper))

    def padded(self, share: float) -> Bounds:
        """The box with ``share`` of its longest side added on all six faces."""
        pad = share * float(self.extent.max())
        return Bounds(self.lower - pad, self.upper + pad)

    def holds(self, xyz: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
        """Which of the points (N, 3) lie inside, as (N,) bool."""
        return np.all((xyz >= self.lower) & (xyz <= self.upper), axis=1)


def find_bounds(
    capture: MaskSource,
    *,
    agreement: float = 0.95,
    least_views: float = 1 / 2,
    margin: float = 0.05,
    most_frames: int = 120,
    track: Track = untracked,
) -> Bounds:
    """The box of the visual hulls over the capture's frames, with a margin.

    Args:
        capture: cameras and masks; frames are read one at a time.
        agreement: share in (0, 1] of the seeing views that must hold a point for it to count.
        least_views: share in (0, 1] of all views that must see a point (at least 3 views, or all of fewer).
        margin: share of the longest side that is added on every face.
        most_frames: at most so many frames are read, evenly spaced, first and last among them.
        track: for progress.

    Raises:
        UserError: when the hull of a frame is empty; names the views that disagree most.
    """
    frames = evenly_spread(capture.frame_count, most_frames)
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
    """The box of one frame's visual hull, to 2% of its longest side, without a margin.

    The search begins in a cube about the point nearest to all optical axes that reaches
    past the farthest camera, and grows when the hull touches the cube's faces.

    Raises:
        UserError: when the hull is empty; names the views that disagree most.
    """
    focus, reach = viewing_region(cameras)
    views = Silhouettes.of(masks, cameras, focus, agreement=agreement, least_views=least_views)
    for half in (1.5 * reach, 3 * reach, 6 * reach):
        cells, size = _survivors(views, half)
        if cells.shape[1] == 0:
            break
        lower = cells.min(axis=1) - size / 2
        upper = cells.max(axis=1) + size / 2
        if max(-float(lower.min()), float(upper.max())) < half - size:
            break
    if cells.shape[1] == 0:
        raise empty_hull(views, 1.5 * reach, names, label)
    return Bounds(focus + lower, focus + upper)


def viewing_region(cameras: Sequence[Camera]) -> tuple[Array, float]:
    """The point (3,) that lies nearest to all optical axes, and its distance to the farthest camera.

    Axes that are almost parallel meet nowhere: a weak pull towards a point in front of
    the rig, four times its spread away, settles those cases and moves others by 0.1%.
    """
    centres = np.stack([camera.centre for camera in cameras])
    axes = np.stack([camera.forward for camera in cameras])
    middle = centres.mean(axis=0)
    spread = float(np.linalg.norm(centres - middle, axis=1).max())
    mean_axis = axes.mean(axis=0)
    guess = middle + 4 * spread * mean_axis / max(float(np.linalg.norm(mean_axis)), 1e-9) * (
        np.linalg.norm(mean_axis) > 0.5
    )
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    pull = 1e-3 * len(cameras)
    matrix = across.sum(axis=0) + pull * np.eye(3)
    focus = np.linalg.solve(matrix, np.einsum("vij,vj->i", across, centres) + pull * guess)
    return focus, max(float(np.linalg.norm(centres - focus, axis=1).max()), 1e-6)


def empty_hull(views: Silhouettes, half: float, names: Sequence[str] | None, label: str) -> UserError:
    """The error for an empty hull in the cube of ``half`` a side, with what each view takes from the others'."""
    labels = list(names) if names is not None else [f"view {i}" for i in range(len(views.views))]
    blank = [name for name, view in zip(labels, views.views, strict=True) if view.distance.max() < 0]
    if len(blank) == len(labels):
        return UserError(
            f"{label}: expected an object in the masks, got none in any view; choose other frames or masks"
        )
    shares = removed_shares(views, half)
    worst = sorted(range(len(labels)), key=lambda i: (-shares[i], i))[:3]
    told = ", ".join(f"{labels[i]} (removes {100 * shares[i]:.0f}% of the others' hull)" for i in worst)
    return UserError(
        f"{label}: expected a visual hull with agreement {views.agreement:g} of the views, got an empty one; "
        f"these views disagree most: {told}; mend their masks or calibration, leave them out, or lower the agreement"
    )


def removed_shares(views: Silhouettes, half: float) -> list[float]:
    """Per view, the share in [0, 1] of the hull of all other views that this view removes.

    Where the others' own hull is empty, their agreement is lowered until something is left.
    The hulls are sought in the cube of ``half`` a side about the origin.
    """
    shares = []
    for index, view in enumerate(views.views):
        others = views.without(index)
        cells = np.zeros((3, 0), dtype=np.float32)
        for agreement in (1.0, 0.9, 0.8, 0.65, 0.5):
            cells, _ = _survivors(replace(others, agreement=agreement), half)
            if cells.shape[1]:
                break
        distance, sees = view_distance(view, cells)
        shares.append(float(np.mean(sees & (distance < 0))) if cells.shape[1] else 0.0)
    return shares


def _survivors(views: Silhouettes, half: float) -> tuple[NDArray[np.float32], float]:
    """Cells (3, N) that may hold the object, refined until the whole is COARSE_CELLS across."""
    size = half / 4
    cells = root_cells(np.full(3, -half), np.full(3, half), size)
    while cells.shape[1]:
        cells = cells[:, views.may_hold(cells, size)]
        if cells.shape[1] == 0:
            break
        extent = float((cells.max(axis=1) - cells.min(axis=1)).max()) + size
        if extent / size >= COARSE_CELLS or size < half / 4096:
            break
        cells, size = refine(cells, size)
    return cells, size
