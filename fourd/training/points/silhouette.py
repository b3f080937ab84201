"""The silhouette constraint, which keeps an object's points inside its mattes."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

from fourd.cameras import Camera
from fourd.model.sources import project_points
from fourd.training.points.frame_points import FramePoints


def revert_moves_out_of_silhouettes(
    points: FramePoints, rows: Tensor, before: Tensor, views: Sequence[tuple[Camera, Tensor]]
) -> None:
    """Undo the moves that took a point out of the silhouette in at least one view.

    A silhouette that did not contain the point before the move has no effect. A view does not constrain points outside
    the view's image.

    Args:
        points: the cloud. Positions are changed in place.
        rows: (M,) indices of the points that moved.
        before: (M, 3) positions of the moved points before the move.
        views: pinhole cameras with their mattes (H, W) in [0, 1].
    """
    moved = points.xyz[rows]
    left = torch.zeros(len(rows), dtype=torch.bool, device=moved.device)
    for camera, matte in views:
        is_outside = ~_is_inside(moved, camera, matte, outside_image=True)
        left |= is_outside & _is_inside(before, camera, matte, outside_image=False)
    points.parameters["xyz"][rows] = torch.where(left[:, None], before, moved)


def _is_inside(xyz: Tensor, camera: Camera, matte: Tensor, outside_image: bool) -> Tensor:
    """(N,) bool, true for points (N, 3) where the matte is at least 0.5. For points outside the image, the result is
    ``outside_image``."""
    pixels, depth = project_points(xyz, (camera,))
    size = torch.tensor([matte.shape[1], matte.shape[0]], dtype=pixels.dtype, device=pixels.device)
    grid = (2 * pixels / size - 1)[:, None]
    covered = functional.grid_sample(matte[None, None], grid, align_corners=False, padding_mode="border")[0, 0, 0]
    within = ((grid[0, 0].abs() < 1).all(dim=-1)) & (depth[0] > 0)
    return torch.where(within, covered >= 0.5, outside_image)
