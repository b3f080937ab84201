"""Calls the CUDA kernels of ``csrc/soft_triangles`` with torch tensors, and allocates their scratch memory."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from fourd.rendering.ops.gpu import Gpu, contiguous, load_gpu


def rasterize(
    inputs: tuple[Tensor, Tensor, Tensor],
    camera: list[float],
    softness: list[float],
    layers: int,
    out: tuple[Tensor, Tensor],
) -> None:
    """Render an image of features and an image of alpha to ``out``. ``inputs`` are xyz, tri and the triangles'
    features."""
    gpu = load_gpu(inputs[0].device)
    with gpu.activate():
        plan = _plan(gpu, inputs, out[1])
        gpu.kernels.rasterize_soft(*map(contiguous, inputs), camera, softness, layers, *plan, gpu.stream, *out)


def rasterize_backward(
    inputs: tuple[Tensor, Tensor, Tensor],
    camera: list[float],
    softness: list[float],
    layers: int,
    gradients: tuple[Tensor, Tensor],
    out: tuple[Tensor, Tensor],
) -> None:
    """Write the gradients of xyz and of the triangles' features to ``out``. ``gradients`` are the gradients of the two
    images that :func:`rasterize` renders: features and alpha."""
    gpu = load_gpu(inputs[0].device)
    with gpu.activate():
        plan = _plan(gpu, inputs, gradients[1])
        gpu.kernels.rasterize_soft_backward(
            *map(contiguous, inputs), camera, softness, layers, *plan, gpu.stream, *map(contiguous, gradients), *out
        )


def _plan(gpu: Gpu, inputs: tuple[Tensor, Tensor, Tensor], alpha: Tensor) -> tuple[Any, int, Tensor]:
    """Predict the number of (triangle, tile) pairs of an image and allocate scratch memory for them."""
    height, width = alpha.shape
    count, channels = inputs[1].shape[0], inputs[2].shape[1]
    entries, size = gpu.kernels.plan_soft_triangles(gpu.estimator, count, channels, width, height)
    return gpu.estimator, entries, gpu.allocate(size)
