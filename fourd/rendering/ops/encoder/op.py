"""The image encoder: the operator ``torch.ops.fourd.encode_images`` and its gradient."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.rendering.ops.encoder.reference import encode_images_reference
from fourd.rendering.ops.gpu import contiguous, cuda_unavailable_reason, load_gpu, uses_gpu_kernels
from fourd.rendering.ops.loading import as_array, load_native, simd_name, thread_count
from fourd.rendering.ops.operator import kernel_array, operator, uninitialised

SHAPES = ((8, 3, 3), (8, 8, 3), (16, 8, 3), (16, 16, 3), (32, 16, 3), (32, 32, 3), (32, 16, 1), (16, 8, 1), (16, 32, 1))
"""Outputs, inputs and side of the kernel of all layers but the last, whose outputs are the features. The order is that
of ``enum Weight`` in ``csrc/encoder/encoder.h``."""
MAX_FEATURES = 64


def encode_images(images: Tensor, weights: Sequence[Tensor], stride: int) -> Tensor:
    """Compute features of V images with the feature pyramid of the point model.

    Float32 images use a kernel on the CPU, whose gradient is bit-identical for any number of threads, and on a CUDA
    device if the CUDA kernels are built. Images in another dtype or with a gradient use the reference.

    Args:
        images: (V, 3, H, W) in [0, 1]; H and W are multiples of 4 * stride.
        weights: weights (outputs, inputs, side, side) and bias (outputs,) of each layer, in the order of ``SHAPES``,
            followed by those of the last layer (C, 16, 3, 3). All have the dtype and the device of the images.
        stride: 1 or 2. The images are averaged over squares with this side first.

    Returns:
        (V, C, H / stride, W / stride) in torch's channels_last format, differentiable in the weights, once.

    Raises:
        ValueError: if shapes do not match.
    """
    device = images.device
    works = device.type == "cpu" or (device.type == "cuda" and not cuda_unavailable_reason())
    has_kernel = works and all(each.device == device and each.dtype == torch.float32 for each in (images, *weights))
    if not has_kernel or images.requires_grad or weights[-1].shape[0] > MAX_FEATURES:
        return encode_images_reference(images, weights, stride)
    _check(images, weights, stride)
    needs_gradient = torch.is_grad_enabled() and any(weight.requires_grad for weight in weights)
    return _encode(images, list(weights), stride, needs_gradient)[0]


def _check(images: Tensor, weights: Sequence[Tensor], stride: int) -> None:
    shapes = [shape for out, inside, side in SHAPES for shape in ((out, inside, side, side), (out,))]
    features = weights[-1].shape[0]
    shapes += [(features, 16, 3, 3), (features,)]
    found = [tuple(weight.shape) for weight in weights]
    if found != shapes:
        raise ValueError(f"weights: expected the shapes {shapes}, got {found}")
    step = 4 * stride
    if images.ndim != 4 or images.shape[1] != 3 or images.shape[2] % step or images.shape[3] % step:
        raise ValueError(f"images: expected (V, 3, H, W) with multiples of {step}, got {tuple(images.shape)}")


def _joined(weights: Sequence[Tensor]) -> NDArray[np.float32]:
    return np.concatenate([as_array(weight).reshape(-1) for weight in weights])


def _sizes(images: Tensor, stride: int) -> tuple[int, int]:
    """Return the numbers of floats that the gradient reads from the forward pass, and that it needs as workspace."""
    views, _, height, width = images.shape
    if uses_gpu_kernels(images):
        saved, workspace = load_gpu(images.device).kernels.encoder_sizes(views, height, width, stride)
        return saved, workspace
    return views * load_native().encoder_saved_size(height, width, stride), 0


def _empty_outputs(images: Tensor, weights: list[Tensor], stride: int, needs_gradient: bool) -> tuple[Tensor, Tensor]:
    views, _, height, width = images.shape
    shape = (views, weights[-1].shape[0], height // stride, width // stride)
    features = torch.empty(shape, dtype=images.dtype, device=images.device, memory_format=torch.channels_last)
    return features, uninitialised(images, _sizes(images, stride)[0] if needs_gradient else 0)


@operator("fourd::encode_images", outputs=_empty_outputs)
def _encode(images: Tensor, weights: list[Tensor], stride: int, needs_gradient: bool) -> tuple[Tensor, Tensor]:
    """Compute the features, and the maps of the network that the gradient needs."""
    features, saved = _empty_outputs(images, weights, stride, needs_gradient)
    if uses_gpu_kernels(images):
        gpu = load_gpu(images.device)
        maps = saved if needs_gradient else uninitialised(images, _sizes(images, stride)[0])
        arrays = (contiguous(images), [contiguous(weight) for weight in weights])
        with gpu.activate():
            gpu.kernels.encode_images(*arrays, stride, gpu.stream, features.permute(0, 2, 3, 1), maps)
        return features, saved
    load_native().encode_images(
        kernel_array(images),
        _joined(weights),
        stride,
        thread_count(0, torch.get_num_threads()),
        simd_name(),
        kernel_array(features.permute(0, 2, 3, 1)),
        kernel_array(saved) if needs_gradient else None,
    )
    return features, saved


def _empty_gradients(weights: list[Tensor]) -> list[Tensor]:
    return [uninitialised(weight, *weight.shape) for weight in weights]


@operator("fourd::encode_images_backward", outputs=_empty_gradients)
def _encode_backward(
    images: Tensor, saved: Tensor, weights: list[Tensor], stride: int, gradient: Tensor
) -> list[Tensor]:
    """Compute the gradients of the weights."""
    out = _empty_gradients(weights)
    by_pixel = gradient.permute(0, 2, 3, 1)
    if uses_gpu_kernels(images):
        gpu = load_gpu(images.device)
        workspace = uninitialised(images, _sizes(images, stride)[1])
        arrays = (contiguous(images), saved, [contiguous(weight) for weight in weights])
        with gpu.activate():
            gpu.kernels.encode_images_backward(*arrays, stride, gpu.stream, contiguous(by_pixel), workspace, out)
        return out
    joined = _joined(weights)
    found = np.empty_like(joined)
    load_native().encode_images_backward(
        kernel_array(images),
        kernel_array(saved),
        joined,
        stride,
        thread_count(0, torch.get_num_threads()),
        simd_name(),
        kernel_array(by_pixel),
        found,
    )
    used = 0
    for each in out:
        array = as_array(each)
        array[...] = found[used : used + array.size].reshape(array.shape)
        used += array.size
    return out


def _setup(ctx: Any, inputs: tuple[Tensor, list[Tensor], int, bool], output: tuple[Tensor, Tensor]) -> None:
    images, weights, stride, _ = inputs
    ctx.set_materialize_grads(False)
    ctx.mark_non_differentiable(output[1])
    ctx.save_for_backward(images, output[1], *weights)
    ctx.stride = stride


def _backward(ctx: Any, gradient: Tensor | None, _: Tensor | None) -> tuple[None, list[Tensor] | None, None, None]:
    images, saved, *weights = ctx.saved_tensors
    if gradient is None:
        return None, None, None, None
    return None, _encode_backward(images, saved, weights, ctx.stride, gradient), None, None


_encode.register_autograd(_backward, setup_context=_setup)
