"""Triangle splatting: the operator ``torch.ops.fourd.splat_triangles`` with its gradient.

The public API, which checks the arguments and selects the backend, is :mod:`fourd.rendering.triangles.splatting`. The
operator supports autograd, ``torch.library.opcheck`` and, through fake implementations, ``torch.compile``.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import uses_gpu_kernels
from fourd.rendering.ops.loading import as_array, load_native, simd_name, thread_count
from fourd.rendering.ops.operator import operator
from fourd.rendering.ops.splat_triangles import cuda as gpu

GEOMETRY_CHANNELS = 4
"""Number of geometry channels: three for the normal and one for the camera depth. They are the last channels of the
features if geometry is rendered."""

Render = tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]


@operator(
    "fourd::splat_triangles",
    outputs=lambda features, geometry, width, height: _empty_image(features, geometry, width, height),
)
def splat(
    xyz: Tensor,
    tri: Tensor,
    features: Tensor,
    opacity: Tensor,
    sigma: Tensor,
    geometry: bool,
    camera: list[float],
    width: int,
    height: int,
    layers: int,
    near: float,
    threads: int,
) -> Render:
    """Render triangles. ``camera`` is the result of ``pack_camera``.

    Returns:
        features (H, W, C), alpha (H, W), transmittance (H, W) = 1 - alpha, normal (H, W, 3), depth (H, W), and weight
        (T,), which is each triangle's maximum compositing weight over all pixels. If ``geometry`` is False, normal and
        depth are empty tensors. Transmittance and weight have no gradient.
    """
    out = _empty_image(features, geometry, width, height)
    inputs = (xyz, tri, features, opacity, sigma)
    if uses_gpu_kernels(xyz):
        gpu.splat(inputs, geometry, camera, layers, near, out)
        return out
    load_native().splat_triangles(
        *map(as_array, inputs),
        geometry,
        camera,
        layers,
        near,
        thread_count(threads, torch.get_num_threads()),
        simd_name(),
        *map(as_array, out),
    )
    return out


@operator(
    "fourd::splat_triangles_backward",
    outputs=lambda xyz, features, opacity, sigma: _empty_gradients(xyz, features, opacity, sigma),
)
def splat_backward(
    xyz: Tensor,
    tri: Tensor,
    features: Tensor,
    opacity: Tensor,
    sigma: Tensor,
    rendered: list[Tensor],
    gradients: list[Tensor],
    geometry: bool,
    camera: list[float],
    layers: int,
    near: float,
    threads: int,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Compute the gradients of ``xyz``, ``features``, ``opacity`` and ``sigma``.

    ``rendered`` are the first five results of the operator. ``gradients`` are the gradients of features, alpha, normal
    and depth.
    """
    out = _empty_gradients(xyz, features, opacity, sigma)
    inputs = (xyz, tri, features, opacity, sigma)
    if uses_gpu_kernels(xyz):
        gpu.splat_backward(inputs, geometry, camera, layers, near, rendered, gradients, out)
        return out
    load_native().splat_triangles_backward(
        *map(as_array, inputs),
        geometry,
        camera,
        layers,
        near,
        thread_count(threads, torch.get_num_threads()),
        simd_name(),
        *map(as_array, rendered),
        *map(as_array, gradients),
        *map(as_array, out),
    )
    return out


def _setup(ctx: Any, inputs: tuple[Any, ...], output: Render) -> None:
    xyz, tri, features, opacity, sigma, geometry, camera, _, _, layers, near, threads = inputs
    ctx.set_materialize_grads(False)
    ctx.mark_non_differentiable(output[2], output[5])
    ctx.save_for_backward(xyz, tri, features, opacity, sigma, *output[:5])
    ctx.settings = (geometry, camera, layers, near, threads)


def _backward(
    ctx: Any,
    grad_features: Tensor | None,
    grad_alpha: Tensor | None,
    grad_transmittance: Tensor | None,
    grad_normal: Tensor | None,
    grad_depth: Tensor | None,
    grad_weight: Tensor | None,
) -> tuple[Tensor | None, ...]:
    xyz, tri, features, opacity, sigma, *rendered = ctx.saved_tensors
    images = (rendered[0], rendered[1], rendered[3], rendered[4])
    gradients = [
        torch.zeros_like(image) if gradient is None else gradient
        for image, gradient in zip(images, (grad_features, grad_alpha, grad_normal, grad_depth), strict=True)
    ]
    to_xyz, to_features, to_opacity, to_sigma = splat_backward(
        xyz, tri, features, opacity, sigma, rendered, gradients, *ctx.settings
    )
    tri = geometry = camera = width = height = layers = near = threads = None
    return to_xyz, tri, to_features, to_opacity, to_sigma, geometry, camera, width, height, layers, near, threads


splat.register_autograd(_backward, setup_context=_setup)


def _empty_image(features: Tensor, geometry: bool, width: int, height: int) -> Render:
    channels = features.shape[1] - (GEOMETRY_CHANNELS if geometry else 0)
    size = (height, width)
    extra = size if geometry else (0, 0)
    return (
        features.new_empty(*size, channels),
        features.new_empty(size),
        features.new_empty(size),
        features.new_empty(*extra, 3),
        features.new_empty(extra),
        features.new_empty(features.shape[0]),
    )


def _empty_gradients(
    xyz: Tensor, features: Tensor, opacity: Tensor, sigma: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    layout = torch.contiguous_format
    return (
        torch.empty_like(xyz, memory_format=layout),
        torch.empty_like(features, memory_format=layout),
        torch.empty_like(opacity, memory_format=layout),
        torch.empty_like(sigma, memory_format=layout),
    )
