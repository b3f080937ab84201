"""Calls the CUDA kernels of ``csrc/points`` with torch tensors, and allocates their scratch memory."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from fourd.rendering.ops.gpu import Gpu, contiguous, load_gpu

MAX_LAYERS_BACKWARD = 64
"""Maximum number of depth layers per pixel in the gradient kernel, where each thread stores one pixel's layers in its
local memory."""


def render(
    inputs: tuple[Tensor, Tensor, Tensor, Tensor],
    camera: list[float],
    layers: int,
    near: float,
    transmittance_min: float,
    out: tuple[Tensor, Tensor, Tensor],
) -> None:
    """Render points and write features (H, W, C), alpha (H, W) and depth (H, W) to ``out``.

    ``inputs`` are xyz, features, radius and density.
    """
    gpu = load_gpu(inputs[0].device)
    height, width = out[1].shape
    with gpu.activate():
        plan = _plan(gpu, inputs[0].shape[0], inputs[1].shape[1], width, height)
        gpu.kernels.render_points(
            *_contiguous(inputs), camera, layers, near, transmittance_min, *plan, gpu.stream, *out
        )


def render_backward(
    inputs: tuple[Tensor, Tensor, Tensor, Tensor],
    camera: list[float],
    layers: int,
    near: float,
    gradients: tuple[Tensor, Tensor, Tensor | None],
    out: tuple[Tensor, Tensor, Tensor, Tensor],
) -> None:
    """Write the gradients of xyz, features, radius and density to ``out``.

    ``gradients`` are the gradients of the rendered features, alpha and depth.
    """
    gpu = load_gpu(inputs[0].device)
    height, width = gradients[1].shape
    with gpu.activate():
        plan = _plan(gpu, inputs[0].shape[0], inputs[1].shape[1], width, height)
        gpu.kernels.render_points_backward(
            *_contiguous(inputs),
            camera,
            layers,
            near,
            *plan,
            gpu.stream,
            *_contiguous(gradients[:2]),
            None if gradients[2] is None else contiguous(gradients[2]),
            *out,
        )


def visibility(
    inputs: tuple[Tensor, Tensor, Tensor],
    camera: list[float],
    size: tuple[int, int],
    layers: int,
    near: float,
    out: Tensor,
) -> None:
    """Write each point's maximum compositing weight over all pixels to ``out`` (N,).

    ``size`` is (width, height) in pixels.
    """
    gpu = load_gpu(inputs[0].device)
    with gpu.activate():
        plan = _plan(gpu, inputs[0].shape[0], 0, *size)
        gpu.kernels.point_visibility(*_contiguous(inputs), camera, *size, layers, near, *plan, gpu.stream, out)


def _plan(gpu: Gpu, count: int, channels: int, width: int, height: int) -> tuple[Any, int, Tensor]:
    """Predict the number of (point, tile) pairs of an image and allocate scratch memory for them."""
    entries, size = gpu.kernels.plan_points(gpu.estimator, count, channels, width, height)
    return gpu.estimator, entries, gpu.allocate(size)


def _contiguous(tensors: tuple[Tensor, ...]) -> list[Tensor]:
    return [contiguous(tensor) for tensor in tensors]
