"""The pixel filter's CUDA kernel, for 8-bit torch images."""

from __future__ import annotations

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import load_gpu
from fourd.rendering.ops.points.validation import check_canvas


def filter_pixels_gpu(image: Tensor, side: float, out: Tensor | None = None) -> Tensor:
    """Filter an (H, W, 4) uint8 image on its device, as :func:`fourd.rendering.ops.pixel_filter.op.filter_pixels` does.

    The kernel is queued on torch's current stream, and the call returns before it finishes. For CPU tensors,
    the kernel runs in the emulator (:mod:`fourd.rendering.ops.gpu`).

    Returns:
        (H, W, 4) uint8 image on the device, which is ``out`` itself if given. ``out`` must not overlap ``image``.

    Raises:
        TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
    """
    gpu = load_gpu(image.device)
    if out is None:
        out = torch.empty_like(image)
    height, width, channels = image.shape
    check_canvas(out, (height, width, channels), out.is_contiguous())
    with gpu.activate():
        gpu.kernels.filter_pixels(image, side, gpu.stream, out)
    return out
