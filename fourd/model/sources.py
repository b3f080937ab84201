"""Source views: the images around a viewing camera, and what a point sees in them."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from fourd.cameras import Camera
from fourd.ops.points.validation import pack_camera
from fourd.ops.sources import op as ops
from fourd.ops.sources import reference

OCCLUSION_FALLOFF_SPACINGS = 1.0
"""A hidden point loses its say over so many distances to its neighbours, once it is twice as far behind."""


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
    cameras = _pack_cameras(sources.cameras)
    views = (sources.images, sources.mattes, sources.depth)
    channels, trust = ops.sample_sources(xyz, features, *views, cameras, softness)
    return SourceSamples(channels.transpose(1, 2), trust)


def project_points(xyz: Tensor, cameras: tuple[Camera, ...]) -> tuple[Tensor, Tensor]:
    """World points (N, 3) in V cameras -> pixels (V, N, 2) and depth (V, N) in world units.

    Points at or behind a camera get pixels far outside its image.
    """
    return reference.project_points(xyz, _pack_cameras(cameras))


def _pack_cameras(cameras: tuple[Camera, ...]) -> list[float]:
    return [number for camera in cameras for number in pack_camera(camera)]
