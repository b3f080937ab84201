"""Sampling of source views at projected points, in plain torch."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional

MIN_SOFTNESS = 1e-12


def sample_sources_reference(
    xyz: Tensor,
    features: Tensor | None,
    images: Tensor,
    mattes: Tensor,
    depth: Tensor | None,
    cameras: Sequence[float],
    softness: Tensor,
) -> tuple[Tensor, Tensor]:
    """Compute the result of :func:`fourd.rendering.ops.sources.op.sample_sources` on any device, in float32 or
    float64."""
    pixels, point_depth = project_points(xyz, cameras)
    height, width = images.shape[-2:]
    size = torch.tensor([width, height], dtype=pixels.dtype, device=pixels.device)
    grid = (2 * pixels / size - 1)[:, None]
    channels = functional.grid_sample(images, grid, align_corners=False)[:, :, 0]
    if features is not None:
        encoded = functional.grid_sample(features, grid, align_corners=False)[:, :, 0]
        channels = torch.cat([encoded, channels], dim=1)
    with torch.no_grad():
        fixed = grid.detach()
        matte = functional.grid_sample(mattes[:, None], fixed, align_corners=False)[:, 0, 0]
        visibility = matte.square() * (point_depth > 0)
        if depth is not None:
            surface = functional.grid_sample(
                depth[:, None], fixed, mode="nearest", padding_mode="border", align_corners=False
            )[:, 0, 0]
            soft = softness.clamp(min=MIN_SOFTNESS)
            behind = (point_depth - surface - 2 * soft).clamp(min=0)
            visibility = visibility * torch.exp(-behind / soft)
    return channels, visibility


def project_points(xyz: Tensor, cameras: Sequence[float]) -> tuple[Tensor, Tensor]:
    """Project world points (N, 3) into V pinhole cameras.

    Args:
        cameras: concatenated results of :func:`fourd.rendering.ops.points.validation.pack_camera` for all cameras.

    Returns:
        pixel coordinates (V, N, 2) as (x, y), and depth (V, N) in world units, both differentiable in ``xyz``. Points
        with a depth of at most 1e-6 get pixel coordinates far outside the image.
    """
    numbers = torch.tensor(cameras, dtype=torch.float64).reshape(-1, 21)
    rotation, translation = numbers[:, 9:18].reshape(-1, 3, 3), numbers[:, 18:, None]
    extrinsics = torch.cat([rotation, translation], dim=2).to(xyz)
    intrinsics = numbers[:, :9].reshape(-1, 3, 3).contiguous().to(xyz)
    xyz_camera = xyz @ extrinsics[:, :, :3].transpose(1, 2) + extrinsics[:, None, :, 3]
    depth = xyz_camera[..., 2]
    in_front = depth > 1e-6
    safe = torch.where(in_front, depth, torch.ones_like(depth))
    pixels = (xyz_camera @ intrinsics[:, :2].transpose(1, 2)) / safe[..., None]
    return torch.where(in_front[..., None], pixels, torch.full_like(pixels, -1e6)), depth
