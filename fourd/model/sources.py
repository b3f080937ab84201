"""Source views: the images around a viewing camera, and what a point sees in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from fourd.cameras import Camera
from fourd.ops.gpu import cuda_unavailable_reason
from fourd.ops.points.validation import pack_camera
from fourd.ops.sources.op import MAX_VIEWS_GPU, sample

OCCLUSION_FALLOFF_SPACINGS = 1.0
"""A hidden point loses its say over so many distances to its neighbours, once it is twice as far behind."""
MIN_SOFTNESS = 1e-12


@dataclass(frozen=True)
class SourceViews:
    """V images of one frame, cropped to a common size, with their cameras.

    Attributes:
        images: (V, 3, H, W) float32 in [0, 1]; H and W are multiples of 8.
        mattes: (V, H, W) float32 in [0, 1], 1 where the object covers the pixel.
        depth: (V, H, W) float32 depth of the nearest surface in world units, infinite where there
            is none; None when occlusion is not tested.
        cameras: the V cameras of the crops.
        encoded: (V, C, h, w) what the image CNN makes of the images, where that is known; else it is asked.
    """

    images: Tensor
    mattes: Tensor
    depth: Tensor | None
    cameras: tuple[Camera, ...]
    encoded: Tensor | None = None


@dataclass(frozen=True)
class SourceSamples:
    """What V source views hold at N points.

    Attributes:
        channels: (V, N, C) image features and RGB (the last three), differentiable.
        trust: (V, N) in [0, 1]: the matte squared times visibility; no gradient.
    """

    channels: Tensor
    trust: Tensor

    @property
    def colours(self) -> Tensor:
        """(V, N, 3) RGB."""
        return self.channels[..., -3:]


def sample_sources(xyz: Tensor, sources: SourceViews, features: Tensor | None, softness: Tensor) -> SourceSamples:
    """Project points into every source view and sample it bilinearly.

    Args:
        xyz: (N, 3) world points; gradients flow through the projection.
        sources: the views.
        features: (V, C, h, w) of the image CNN over the same views, at its own resolution, or None
            for RGB alone.
        softness: (N,) depth in world units over which a hidden point loses its say, once it lies twice that
            behind what a view sees there; no gradient.

    The matte is squared: a pixel on the silhouette mixes in background, so that trust must fall
    faster than coverage does. In float32, on the CPU or a CUDA device with kernels, all is one kernel.
    """
    device = xyz.device.type
    on_gpu = device == "cuda" and not cuda_unavailable_reason() and len(sources.cameras) <= MAX_VIEWS_GPU
    if xyz.dtype != torch.float32 or not (on_gpu or device == "cpu"):
        return sample_sources_reference(xyz, sources, features, softness)
    cameras = [number for camera in sources.cameras for number in pack_camera(camera)]
    channels, trust = sample(xyz, features, sources.images, sources.mattes, sources.depth, cameras, softness)
    return SourceSamples(channels.transpose(1, 2), trust)


def sample_sources_reference(
    xyz: Tensor, sources: SourceViews, features: Tensor | None, softness: Tensor
) -> SourceSamples:
    """What :func:`sample_sources` promises, in plain torch; any device."""
    pixels, depth = project_points(xyz, sources.cameras)
    height, width = sources.images.shape[-2:]
    size = torch.tensor([width, height], dtype=pixels.dtype, device=pixels.device)
    grid = (2 * pixels / size - 1)[:, None]
    channels = functional.grid_sample(sources.images, grid, align_corners=False)[:, :, 0]
    if features is not None:
        encoded = functional.grid_sample(features, grid, align_corners=False)[:, :, 0]
        channels = torch.cat([encoded, channels], dim=1)
    channels = channels.transpose(1, 2)
    with torch.no_grad():
        fixed = grid.detach()
        matte = functional.grid_sample(sources.mattes[:, None], fixed, align_corners=False)[:, 0, 0]
        trust = matte.square() * (depth > 0)
        if sources.depth is not None:
            surface = functional.grid_sample(
                sources.depth[:, None], fixed, mode="nearest", padding_mode="border", align_corners=False
            )[:, 0, 0]
            soft = softness.clamp(min=MIN_SOFTNESS)
            behind = (depth - surface - 2 * soft).clamp(min=0)
            trust = trust * torch.exp(-behind / soft)
    return SourceSamples(channels, trust)


def project_points(xyz: Tensor, cameras: tuple[Camera, ...]) -> tuple[Tensor, Tensor]:
    """World points (N, 3) in V cameras -> pixels (V, N, 2) and depth (V, N) in world units.

    Points at or behind a camera get pixels far outside its image.
    """
    extrinsics = _stacked([np.column_stack([c.rotation, c.translation]) for c in cameras], xyz)
    intrinsics = _stacked([c.intrinsics for c in cameras], xyz)
    xyz_camera = xyz @ extrinsics[:, :, :3].transpose(1, 2) + extrinsics[:, None, :, 3]
    depth = xyz_camera[..., 2]
    in_front = depth > 1e-6
    safe = torch.where(in_front, depth, torch.ones_like(depth))
    pixels = (xyz_camera @ intrinsics[:, :2].transpose(1, 2)) / safe[..., None]
    return torch.where(in_front[..., None], pixels, torch.full_like(pixels, -1e6)), depth


def _stacked(matrices: list[np.ndarray], like: Tensor) -> Tensor:
    return torch.from_numpy(np.stack(matrices)).to(like)
