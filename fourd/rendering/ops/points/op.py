"""Compositing of points: the operators ``torch.ops.fourd.render_points`` (with its gradient) and ``point_visibility``.

The public API, which checks the arguments and selects the backend, is :mod:`fourd.rendering.points`. The operators
support autograd, ``torch.library.opcheck`` and, through fake implementations, ``torch.compile``.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import uses_gpu_kernels
from fourd.rendering.ops.loading import load_native, simd_name, thread_count
from fourd.rendering.ops.operator import kernel_array, operator, uninitialised
from fourd.rendering.ops.points import cuda as gpu


@operator("fourd::render_points", outputs=lambda features, width, height: _empty_image(features, width, height))
def render(
    xyz: Tensor,
    features: Tensor,
    radius: Tensor,
    density: Tensor,
    camera: list[float],
    width: int,
    height: int,
    layers: int,
    near: float,
    transmittance_min: float,
    threads: int,
) -> tuple[Tensor, Tensor, Tensor]:
    """Render features (H, W, C), alpha (H, W) and depth (H, W). ``camera`` is the result of ``pack_camera``."""
    out = _empty_image(features, width, height)
    if uses_gpu_kernels(xyz):
        gpu.render((xyz, features, radius, density), camera, layers, near, transmittance_min, out)
        return out
    arrays = [kernel_array(tensor) for tensor in (xyz, features, radius, density)]
    count = thread_count(threads, torch.get_num_threads())
    load_native().render_points(
        *arrays, camera, layers, near, transmittance_min, count, simd_name(), *map(kernel_array, out)
    )
    return out


@operator(
    "fourd::render_points_backward",
    outputs=lambda xyz, features, radius, density: _empty_gradients(xyz, features, radius, density),
)
def render_backward(
    xyz: Tensor,
    features: Tensor,
    radius: Tensor,
    density: Tensor,
    grad_features: Tensor,
    grad_alpha: Tensor,
    grad_depth: Tensor | None,
    camera: list[float],
    layers: int,
    near: float,
    threads: int,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Compute the gradients of xyz, features, radius and density from the gradients of the rendered images."""
    inputs = (xyz, features, radius, density)
    out = _empty_gradients(*inputs)
    if uses_gpu_kernels(xyz):
        gpu.render_backward(inputs, camera, layers, near, (grad_features, grad_alpha, grad_depth), out)
        return out
    load_native().render_points_backward(
        *map(kernel_array, inputs),
        camera,
        layers,
        near,
        thread_count(threads, torch.get_num_threads()),
        simd_name(),
        kernel_array(grad_features),
        kernel_array(grad_alpha),
        None if grad_depth is None else kernel_array(grad_depth),
        *map(kernel_array, out),
    )
    return out


def _setup(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, ...]) -> None:
    xyz, features, radius, density, camera, width, height, layers, near, transmittance_min, threads = inputs
    if transmittance_min > 0 and any(tensor.requires_grad for tensor in (xyz, features, radius, density)):
        raise ValueError(f"transmittance_min: expected 0 where gradients are required, got {transmittance_min}")
    if any(tensor.requires_grad for tensor in (xyz, features, radius, density)):
        _check_layers(xyz, layers)
    ctx.set_materialize_grads(False)
    ctx.save_for_backward(xyz, features, radius, density)
    ctx.size = (height, width)
    ctx.settings = (camera, layers, near, threads)


def _backward(
    ctx: Any, grad_features: Tensor | None, grad_alpha: Tensor | None, grad_depth: Tensor | None
) -> tuple[Tensor | None, ...]:
    xyz, features, radius, density = ctx.saved_tensors
    if grad_features is None:
        grad_features = features.new_zeros(*ctx.size, features.shape[1])
    if grad_alpha is None:
        grad_alpha = features.new_zeros(ctx.size)
    gradients = render_backward(xyz, features, radius, density, grad_features, grad_alpha, grad_depth, *ctx.settings)
    camera = width = height = layers = near = transmittance_min = threads = None
    return *gradients, camera, width, height, layers, near, transmittance_min, threads


render.register_autograd(_backward, setup_context=_setup)


@operator("fourd::point_visibility", outputs=lambda radius: uninitialised(radius, *radius.shape))
def visibility(
    xyz: Tensor,
    radius: Tensor,
    density: Tensor,
    camera: list[float],
    width: int,
    height: int,
    layers: int,
    near: float,
    threads: int,
) -> Tensor:
    """Compute each point's maximum compositing weight (N,) over all pixels."""
    out = uninitialised(radius, *radius.shape)
    if uses_gpu_kernels(xyz):
        gpu.visibility((xyz, radius, density), camera, (width, height), layers, near, out)
        return out
    count = thread_count(threads, torch.get_num_threads())
    arrays = [kernel_array(tensor) for tensor in (xyz, radius, density)]
    load_native().point_visibility(*arrays, camera, width, height, layers, near, count, simd_name(), kernel_array(out))
    return out


def _check_layers(xyz: Tensor, layers: int) -> None:
    """Check that the gradient kernel on the GPU can store ``layers`` depth layers per pixel."""
    if uses_gpu_kernels(xyz) and layers > gpu.MAX_LAYERS_BACKWARD:
        expected = f"at most {gpu.MAX_LAYERS_BACKWARD} where gradients are required on a GPU"
        raise ValueError(f"layers: expected {expected}, got {layers}; backend='reference' takes any number")


def _empty_image(features: Tensor, width: int, height: int) -> tuple[Tensor, Tensor, Tensor]:
    return (
        uninitialised(features, height, width, features.shape[1]),
        uninitialised(features, height, width),
        uninitialised(features, height, width),
    )


def _empty_gradients(
    xyz: Tensor, features: Tensor, radius: Tensor, density: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    to_xyz, to_features, to_radius, to_density = (
        uninitialised(each, *each.shape) for each in (xyz, features, radius, density)
    )
    return to_xyz, to_features, to_radius, to_density
