"""Soft rasterization: the operator ``torch.ops.fourd.rasterize_soft`` with its gradient.

The public API, which checks the arguments and selects the backend, is :mod:`fourd.rendering.triangles.soft`. The
operator supports autograd, ``torch.library.opcheck`` and, through fake implementations, ``torch.compile``.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import uses_gpu_kernels
from fourd.rendering.ops.loading import as_array, load_native, simd_name, thread_count
from fourd.rendering.ops.operator import operator
from fourd.rendering.ops.soft_triangles import cuda as gpu


@operator(
    "fourd::rasterize_soft",
    outputs=lambda features, width, height: (
        features.new_empty(height, width, features.shape[1]),
        features.new_empty(height, width),
    ),
)
def rasterize(
    xyz: Tensor,
    tri: Tensor,
    features: Tensor,
    camera: list[float],
    width: int,
    height: int,
    softness: list[float],
    layers: int,
    threads: int,
) -> tuple[Tensor, Tensor]:
    """Render features (H, W, C) and alpha (H, W).

    ``camera`` is the result of ``pack_camera``, and ``softness`` is the result of ``Softness.pack``.
    """
    out = (features.new_empty(height, width, features.shape[1]), features.new_empty(height, width))
    inputs = (xyz, tri, features)
    if uses_gpu_kernels(xyz):
        gpu.rasterize(inputs, camera, softness, layers, out)
        return out
    count = thread_count(threads, torch.get_num_threads())
    load_native().rasterize_soft(
        *map(as_array, inputs), camera, softness, layers, count, simd_name(), *map(as_array, out)
    )
    return out


@operator("fourd::rasterize_soft_backward", outputs=lambda xyz, features: _empty_gradients(xyz, features))
def rasterize_backward(
    xyz: Tensor,
    tri: Tensor,
    features: Tensor,
    grad_features: Tensor,
    grad_alpha: Tensor,
    camera: list[float],
    softness: list[float],
    layers: int,
    threads: int,
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of ``xyz`` and ``features`` from the gradients of the rendered images."""
    out = _empty_gradients(xyz, features)
    inputs, gradients = (xyz, tri, features), (grad_features, grad_alpha)
    if uses_gpu_kernels(xyz):
        gpu.rasterize_backward(inputs, camera, softness, layers, gradients, out)
        return out
    count = thread_count(threads, torch.get_num_threads())
    arrays = map(as_array, inputs)
    load_native().rasterize_soft_backward(
        *arrays, camera, softness, layers, count, simd_name(), *map(as_array, gradients), *map(as_array, out)
    )
    return out


def _setup(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
    xyz, tri, features, camera, width, height, softness, layers, threads = inputs
    ctx.set_materialize_grads(False)
    ctx.save_for_backward(xyz, tri, features)
    ctx.size = (height, width)
    ctx.settings = (camera, softness, layers, threads)


def _backward(ctx: Any, grad_features: Tensor | None, grad_alpha: Tensor | None) -> tuple[Tensor | None, ...]:
    xyz, tri, features = ctx.saved_tensors
    if grad_features is None:
        grad_features = features.new_zeros(*ctx.size, features.shape[1])
    if grad_alpha is None:
        grad_alpha = features.new_zeros(ctx.size)
    to_xyz, to_features = rasterize_backward(xyz, tri, features, grad_features, grad_alpha, *ctx.settings)
    tri = camera = width = height = softness = layers = threads = None
    return to_xyz, tri, to_features, camera, width, height, softness, layers, threads


rasterize.register_autograd(_backward, setup_context=_setup)


def _empty_gradients(xyz: Tensor, features: Tensor) -> tuple[Tensor, Tensor]:
    layout = torch.contiguous_format
    return torch.empty_like(xyz, memory_format=layout), torch.empty_like(features, memory_format=layout)
