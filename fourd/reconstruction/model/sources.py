"""Source views (the images nearest to a viewing camera), and their samples at points."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.rendering.ops.points.validation import pack_camera
from fourd.rendering.ops.sources import op as ops
from fourd.rendering.ops.sources import reference

OCCLUSION_FALLOFF_SPACINGS = 1.0
"""Decay length of visibility weights, as a multiple of the point spacing. A point's weight decays exponentially with
its depth behind the nearest surface, starting two decay lengths behind the surface."""


@dataclass(frozen=True)
class SourceViews:
    """V images of one frame, cropped or padded to a common size, with their cameras.

    Attributes:
        images: (V, 3, H, W) float32 in [0, 1]; H and W are multiples of 8.
        mattes: (V, H, W) float32 in [0, 1]; 1 where the object covers the pixel.
        depth: (V, H, W) float32 depth of the nearest surface in world units, infinite where there is no surface; None
            if occlusion is not tested.
        cameras: the V cameras of the cropped or padded images.
        encoded: (V, C, h, w) cached features of the image encoder, where h and w are H and W divided by the encoder's
            stride; None if the features are not cached.
        weights: (V,) view weights in [0, 1], which multiply the blend weights; None if all view weights are 1.
    """

    images: Tensor
    mattes: Tensor
    depth: Tensor | None
    cameras: tuple[Camera, ...]
    encoded: Tensor | None = None
    weights: Tensor | None = None

    def weighted(self, weights: NDArray[np.float32]) -> SourceViews:
        """Return the same views with the view weights ``weights`` (V,)."""
        return replace(self, weights=torch.from_numpy(weights).to(self.images))


@dataclass(frozen=True)
class SourceSamples:
    """Values of V source views at the projections of N points.

    Attributes:
        channels: (V, N, C) image features followed by RGB (the last three channels), differentiable.
        visibility: (V, N) visibility weights in [0, 1], without gradient; see :func:`sample_sources`.
    """

    channels: Tensor
    visibility: Tensor

    @property
    def colours(self) -> Tensor:
        """(V, N, 3) RGB."""
        return self.channels[..., -3:]


def sample_sources(xyz: Tensor, sources: SourceViews, features: Tensor | None, softness: Tensor) -> SourceSamples:
    """Project points into every source view and sample the views bilinearly.

    A point's visibility weight in a view is the square of the matte at its projection, times an occlusion factor. This
    factor falls with the depth of the point behind the nearest surface (see ``softness``). The matte is squared because
    pixels on the silhouette also contain background colour, so their weight must be lower than their coverage. For
    float32 inputs, one fused kernel projects the points and samples the views. It runs on the CPU or, if the CUDA
    kernels are compiled, on a CUDA device.

    Args:
        xyz: (N, 3) points in world units. The points get gradients through the projection.
        sources: the source views.
        features: (V, C, h, w) features of ``sources`` from the image encoder, at the encoder's resolution; None to
            sample only RGB.
        softness: (N,) decay length s of each point's occlusion factor, in world units. Let z be the point's depth in
            the view minus the depth of the nearest surface at the point's projection. The factor is
            ``exp(-max(0, z / s - 2))``. No gradient is computed for ``softness``.
    """
    channels, visibility = sample_channels(xyz, sources, features, softness)
    return SourceSamples(channels.transpose(1, 2), visibility)


def sample_channels(
    xyz: Tensor, sources: SourceViews, features: Tensor | None, softness: Tensor
) -> tuple[Tensor, Tensor]:
    """Compute the channels (V, C, N), which are transposed in :class:`SourceSamples`, and the visibility (V, N) that
    :func:`sample_sources` returns."""
    views = (sources.images, sources.mattes, sources.depth)
    return ops.sample_sources(xyz, features, *views, _pack_cameras(sources.cameras), softness)


def project_points(xyz: Tensor, cameras: tuple[Camera, ...]) -> tuple[Tensor, Tensor]:
    """Project world points (N, 3) into V cameras. Returns pixel coordinates (V, N, 2) and depths (V, N) in world units.

    Points at or behind a camera get pixel coordinates far outside its image.
    """
    return reference.project_points(xyz, _pack_cameras(cameras))


def _pack_cameras(cameras: tuple[Camera, ...]) -> list[float]:
    return [number for camera in cameras for number in pack_camera(camera)]
