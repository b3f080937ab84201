"""Photo-consistency: different views of the same surface point must show the same colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from fourd.base.cameras import Camera

MIN_COSINE = 0.25
"""Minimum cosine between the normal and the direction to the camera. Points with a smaller cosine are seen at a grazing
angle and are not compared."""

DEPTH_TOLERANCE_PX = 3.0
"""Tolerance of the visibility test. A point that lies behind the surface in a view's depth image still counts as
visible if its depth exceeds the surface's depth by at most DEPTH_TOLERANCE_PX * z / (f * c). Here, z is the point's
depth, f is the focal length in pixels, and c is the cosine between the point's normal and the direction to the camera.
The width of a pixel at the point's depth is z / f. Division by c gives the length that the pixel covers on a slanted
surface."""


@dataclass(frozen=True, eq=False)
class PhotoView:
    """A view with its data as tensors.

    Attributes:
        camera: pinhole camera.
        rgb: (1, 3, H, W) float32 image in [0, 1].
        matte: (H, W) float32 matte in [0, 1].
        depth: (1, 1, H, W) float32 depth of the current mesh. Pixels that do not show the mesh have a very large depth.
        rotation: (3, 3) float32 R_camera_world.
        translation: (3,) float32 T_camera_world.
        intrinsics: (3, 3) float32, in pixels.
    """

    camera: Camera
    rgb: Tensor
    matte: Tensor
    depth: Tensor
    rotation: Tensor
    translation: Tensor
    intrinsics: Tensor


def photo_loss(xyz: Tensor, normals: Tensor, pixels: Tensor, target: PhotoView, sources: Sequence[PhotoView]) -> Tensor:
    """Return the mean colour difference between a target view and the source views that see the same surface points.

    A source view sees a point if the surface there faces the view's camera and no other part of the mesh hides the
    point. Each point has one colour difference to each source view that sees it, and only the smaller half of these
    differences counts. This ignores most highlights and most errors of the visibility test.

    Args:
        xyz: (P, 3) surface points, differentiable.
        normals: (P, 3) unit normals, constant.
        pixels: (P, 2) int64 row and column of each point in the target view.
        target: the view whose pixels show the points.
        sources: views with which the target view is compared, at least one.

    Returns:
        the loss as a scalar, 0 if no source view sees any of the points.
    """
    wanted = target.rgb[0][:, pixels[:, 0], pixels[:, 1]].T
    differences, seen = [], []
    for source in sources:
        rgb, visible = _sample_view(xyz, normals, source)
        differences.append((rgb - wanted).abs().sum(dim=1))
        seen.append(visible)
    stacked, visible = torch.stack(differences), torch.stack(seen)
    ranked = torch.where(visible, stacked, torch.inf).sort(dim=0)
    kept = torch.arange(len(sources))[:, None] < (visible.sum(dim=0) + 1) // 2
    total = torch.where(kept, ranked.values, torch.zeros(())).sum()
    return total / max(int(kept.sum()), 1)


def _sample_view(xyz: Tensor, normals: Tensor, view: PhotoView) -> tuple[Tensor, Tensor]:
    """Sample the colours (P, 3) that a view's image shows at the points. Also return a mask (P,) that is true for the
    points that the view sees."""
    in_camera = xyz @ view.rotation.T + view.translation
    depth = in_camera[:, 2].clamp(min=1e-6)
    projected = in_camera @ view.intrinsics.T
    height, width = view.matte.shape
    grid = projected[:, :2] / depth[:, None] / torch.tensor([width / 2, height / 2]) - 1
    rgb = torch.nn.functional.grid_sample(view.rgb, grid[None, None], align_corners=False, padding_mode="border")
    with torch.no_grad():
        rays = torch.from_numpy(view.camera.centre.astype(np.float32)) - xyz
        cosine = (rays * normals).sum(dim=1) / rays.norm(dim=1).clamp(min=1e-12)
        nearest = torch.nn.functional.grid_sample(
            view.depth, grid[None, None], mode="nearest", align_corners=False, padding_mode="border"
        )[0, 0, 0]
        tolerance = DEPTH_TOLERANCE_PX * depth / view.intrinsics[1, 1] / cosine.clamp(min=MIN_COSINE)
        visible = (grid.abs() < 1).all(dim=1) & (in_camera[:, 2] > 0) & (cosine > MIN_COSINE)
        visible &= depth <= nearest + tolerance
    return rgb[0, :, 0].T, visible
