"""The silhouette constraint, which keeps an object's points inside its mattes."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from fourd.base.cameras import Camera
from fourd.reconstruction.model.sources import project_points
from fourd.reconstruction.training.points.frame_points import FramePoints
from fourd.rendering.ops.moves import has_kernels, keep_in_silhouettes


def revert_moves_out_of_silhouettes(
    points: FramePoints, rows: Tensor, before: Tensor, views: Sequence[tuple[tuple[Camera, ...], Tensor]]
) -> None:
    """Undo each move that took a point out of the silhouette in at least one view.

    A move takes a point out of the silhouette in a view if the point is inside the silhouette before the move, and
    outside the silhouette but still inside the image after the move.

    Args:
        points: the points of a frame. Their positions are changed in place.
        rows: (M,) indices of the points that moved.
        before: (M, 3) positions of the moved points before the move.
        views: groups of views. Each group consists of V pinhole cameras with equal image sizes, and their mattes (V, H,
            W) in [0, 1].
    """
    if has_kernels(rows, points.xyz, before, *(mattes for _, mattes in views)):
        keep_in_silhouettes(rows, points.xyz, before, views)
        return
    moved = points.xyz[rows]
    left = torch.zeros(len(rows), dtype=torch.bool, device=moved.device)
    for cameras, mattes in views:
        is_in_image, is_covered = _silhouette_samples(torch.cat([before, moved]), cameras, mattes)
        was_inside, is_inside = (is_in_image & is_covered).chunk(2, dim=1)
        can_leave = is_in_image[:, len(rows) :]
        left |= (was_inside & can_leave & ~is_inside).any(dim=0)
    points.parameters["xyz"][rows] = torch.where(left[:, None], before, moved)


def _silhouette_samples(xyz: Tensor, cameras: tuple[Camera, ...], mattes: Tensor) -> tuple[Tensor, Tensor]:
    """Return two masks (V, N) for points (N, 3) and V views. The first is true where the point is inside the image, and
    the second is true where the matte is at least 0.5 at the point."""
    pixels, depth = project_points(xyz, cameras)
    size = torch.tensor([mattes.shape[2], mattes.shape[1]], dtype=pixels.dtype, device=pixels.device)
    grid = 2 * pixels / size - 1
    covered = functional.grid_sample(mattes[:, None], grid[:, None], align_corners=False, padding_mode="border")
    return (grid.abs() < 1).all(dim=-1) & (depth > 0), covered[:, 0, 0] >= 0.5
