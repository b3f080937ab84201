"""Calls the CUDA kernels of ``csrc/splat_triangles`` with torch tensors, and allocates their scratch memory."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from torch import Tensor

from fourd.rendering.ops.gpu import Gpu, contiguous, load_gpu


def splat(
    inputs: tuple[Tensor, ...], geometry: bool, camera: list[float], layers: int, near: float, out: Iterable[Tensor]
) -> None:
    """Render triangles and write features, alpha, transmittance, normal, depth and weight to ``out``.

    ``inputs`` are xyz, tri, features, opacity and sigma.
    """
    images = list(out)
    gpu = load_gpu(inputs[0].device)
    with gpu.activate():
        plan = _plan(gpu, inputs, images[1])
        gpu.kernels.splat_triangles(
            *map(contiguous, inputs), geometry, camera, layers, near, *plan, gpu.stream, *images
        )


def splat_backward(
    inputs: tuple[Tensor, ...],
    geometry: bool,
    camera: list[float],
    layers: int,
    near: float,
    rendered: list[Tensor],
    gradients: list[Tensor],
    out: Iterable[Tensor],
) -> None:
    """Write the gradients of xyz, features, opacity and sigma to ``out``.

    ``rendered`` are features, alpha, transmittance, normal and depth. ``gradients`` are the gradients of features,
    alpha, normal and depth.
    """
    gpu = load_gpu(inputs[0].device)
    with gpu.activate():
        plan = _plan(gpu, inputs, rendered[1])
        gpu.kernels.splat_triangles_backward(
            *map(contiguous, inputs),
            geometry,
            camera,
            layers,
            near,
            *plan,
            gpu.stream,
            *map(contiguous, rendered),
            *map(contiguous, gradients),
            *out,
        )


def _plan(gpu: Gpu, inputs: tuple[Tensor, ...], alpha: Tensor) -> tuple[Any, int, Tensor]:
    """Predict the number of (triangle, tile) pairs of an image and allocate scratch memory for them."""
    height, width = alpha.shape
    entries, size = gpu.kernels.plan_splats(gpu.estimator, inputs[1].shape[0], inputs[2].shape[1], width, height)
    return gpu.estimator, entries, gpu.allocate(size)
