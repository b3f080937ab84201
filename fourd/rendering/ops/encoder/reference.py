"""The image encoder in plain torch."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional


def encode_images_reference(images: Tensor, weights: Sequence[Tensor], stride: int) -> Tensor:
    """Compute the result of :func:`fourd.rendering.ops.encoder.op.encode_images` on any device and in any dtype."""
    # In this memory format, the channels of a pixel are adjacent, also in the feature images that the convolutions
    # return. The kernel that samples the features reads all channels of a pixel together.
    images = images.contiguous(memory_format=torch.channels_last)
    pairs = list(zip(weights[::2], weights[1::2], strict=True))
    full1, full2, half1, half2, quarter1, quarter2, lateral_half, lateral_full, reduce, out = pairs
    full = functional.avg_pool2d(images, stride) if stride > 1 else images
    full = _rectified(_rectified(full, full1), full2)
    half = _rectified(_rectified(full, half1, stride=2), half2)
    quarter = _rectified(_rectified(half, quarter1, stride=2), quarter2)
    half = functional.conv2d(half, *lateral_half) + _upsample(quarter)
    merged = functional.conv2d(full, *lateral_full) + _upsample(functional.conv2d(half, *reduce))
    return functional.conv2d(merged, *out, padding=1)


def _rectified(features: Tensor, layer: tuple[Tensor, Tensor], stride: int = 1) -> Tensor:
    return functional.relu(functional.conv2d(features, *layer, stride=stride, padding=1))


def _upsample(features: Tensor) -> Tensor:
    return functional.interpolate(features, scale_factor=2, mode="bilinear", align_corners=False)
