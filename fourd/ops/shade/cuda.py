"""Colours of baked points seen from a camera, by the CUDA kernel, for torch tensors."""

from __future__ import annotations

import torch
from torch import Tensor

from fourd.ops.gpu import load_gpu
from fourd.ops.shade.shading import Shading


def shade_points_gpu(xyz: Tensor, sh: Tensor, blend_weights: Tensor, rgb: Tensor, shading: Shading) -> Tensor:
    """Compute what :func:`fourd.ops.shade.op.shade_points` specifies, (N, 3) float32 on the tensors' device.

    ``sh`` and ``blend_weights`` hold the bits of float16 as int16; all tensors are contiguous. The work is queued on
    torch's current stream. CPU tensors run the emulated kernel.
    """
    gpu = load_gpu(xyz.device)
    out = torch.empty_like(xyz)
    with gpu.activate():
        gpu.kernels.shade(xyz, sh, blend_weights, rgb, *shading.arguments(), gpu.stream, out)
    return out
