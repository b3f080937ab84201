"""Colours of baked points for a viewpoint: the CUDA kernel, for torch tensors."""

from __future__ import annotations

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import load_gpu
from fourd.rendering.ops.shade.shading import Shading


def shade_points_gpu(xyz: Tensor, sh: Tensor, blend_weights: Tensor, rgb: Tensor, shading: Shading) -> Tensor:
    """Compute the colours of :func:`fourd.rendering.ops.shade.op.shade_points`, (N, 3) float32, on the tensors' device.

    Pass ``sh`` and ``blend_weights`` as int16 tensors with the bits of float16 numbers. All tensors must be contiguous.
    The kernel is queued on torch's current stream. For CPU tensors, it runs in the emulator
    (:mod:`fourd.rendering.ops.gpu`).
    """
    gpu = load_gpu(xyz.device)
    out = torch.empty_like(xyz)
    with gpu.activate():
        gpu.kernels.shade(xyz, sh, blend_weights, rgb, *shading.arguments(), gpu.stream, out)
    return out
