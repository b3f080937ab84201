"""The images of a training step in plain torch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

Bytes = NDArray[np.uint8]


def convert_views_reference(
    views: Sequence[tuple[Bytes, Bytes]], size: tuple[int, int], device: torch.device
) -> tuple[Tensor, Tensor]:
    """Compute the result of :func:`fourd.rendering.ops.step_images.op.convert_views`."""
    padded_rgb = np.zeros((len(views), 3, *size), np.uint8)
    padded_mattes = np.zeros((len(views), *size), np.uint8)
    for i, (rgb, matte) in enumerate(views):
        rows, columns = matte.shape
        padded_rgb[i, :, :rows, :columns] = rgb.transpose(2, 0, 1)
        padded_mattes[i, :rows, :columns] = matte
    # All views are converted by one operation, because calling an operation takes as long as converting a view.
    return torch.from_numpy(padded_rgb).to(device) / 255, torch.from_numpy(padded_mattes).to(device) / 255


def premultiply_reference(rgb: Bytes, matte: Bytes, device: torch.device) -> tuple[Tensor, Tensor]:
    """Compute the result of :func:`fourd.rendering.ops.step_images.op.premultiply`."""
    weight = torch.from_numpy(matte).to(device) / 255
    return torch.from_numpy(rgb).to(device) / 255 * weight[..., None], weight


def resolve_samples_reference(
    features: Tensor, alpha: Tensor, background: Sequence[float], samples: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Compute the result of :func:`fourd.rendering.ops.step_images.op.resolve_samples` on any device and in any
    dtype."""
    means, alpha = average_samples(features, alpha, samples)
    colour = means[..., :3]
    return colour, means[..., 3], on_background(colour, alpha, background)


def average_samples(features: Tensor, alpha: Tensor, samples: int) -> tuple[Tensor, Tensor]:
    """Average features (samples * H, samples * W, C) and alpha (samples * H, samples * W) over the samples of each
    pixel."""
    if samples == 1:
        return features, alpha
    # With a batch axis, torch recognises that the channels of a pixel are adjacent, and does not copy them first.
    channels = torch.cat([features, alpha[..., None]], 2).permute(2, 0, 1)[None]
    means = functional.avg_pool2d(channels, samples)[0].permute(1, 2, 0)
    return means[..., :-1], means[..., -1]


def on_background(rgb: Tensor, alpha: Tensor, background: Sequence[float]) -> Tensor:
    """Add a background colour to premultiplied colours (H, W, 3) with opacities (H, W)."""
    colour = torch.tensor(np.asarray(background), dtype=rgb.dtype, device=rgb.device)
    return rgb + (1 - alpha)[..., None] * colour


def mean_square_reference(values: Tensor, truth: Tensor | None, first: int) -> Tensor:
    """Compute the result of :func:`fourd.rendering.ops.step_images.op.mean_square` on any device and in any dtype."""
    if truth is None:
        return values[..., first:].square().mean()
    return functional.mse_loss(values[..., first:], truth[..., first:])
