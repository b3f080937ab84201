"""The images of a training step: conversion from bytes, and two operators with gradients.
``torch.ops.fourd.resolve_samples`` computes the pixels of a rendered image from its samples, and
``torch.ops.fourd.mean_square`` compares images.

Float32 tensors on the CPU use kernels, whose results are bit-identical for any number of threads and any instruction
set. Other tensors use the functions of :mod:`fourd.rendering.ops.step_images.reference`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import CPU
from fourd.rendering.ops.loading import as_array, load_native, simd_name, thread_count
from fourd.rendering.ops.operator import kernel_array, operator, uninitialised
from fourd.rendering.ops.step_images.reference import (
    Bytes,
    convert_views_reference,
    mean_square_reference,
    on_background,
    premultiply_reference,
    resolve_samples_reference,
)


def convert_views(
    views: Sequence[tuple[Bytes, Bytes]], size: tuple[int, int], device: torch.device = CPU
) -> tuple[Tensor, Tensor]:
    """Convert V views to float32 images in [0, 1] of one size, with zeros at the right and at the bottom.

    Args:
        views: the colours (h, w, 3) and mattes (h, w) of the views, as uint8.
        size: height H and width W of the images.
        device: device of the result.

    Returns:
        images (V, 3, H, W) and mattes (V, H, W).
    """
    if device.type != "cpu":
        return convert_views_reference(views, size, device)
    images, mattes = torch.empty((len(views), 3, *size)), torch.empty((len(views), *size))
    arrays = ([rgb for rgb, _ in views], [matte for _, matte in views])
    load_native().convert_views(*arrays, *_execution(), kernel_array(images), kernel_array(mattes))
    return images, mattes


def premultiply(rgb: Bytes, matte: Bytes, device: torch.device = CPU) -> tuple[Tensor, Tensor]:
    """Convert colours (H, W, 3) and a matte (H, W) from uint8 to float32 in [0, 1]. The colours are multiplied by the
    matte."""
    if device.type != "cpu":
        return premultiply_reference(rgb, matte, device)
    colours, weight = torch.empty(rgb.shape), torch.empty(matte.shape)
    load_native().premultiply(rgb, matte, *_execution(), kernel_array(colours), kernel_array(weight))
    return colours, weight


def add_background(rgb: Tensor, alpha: Tensor, background: Sequence[float]) -> Tensor:
    """Add a background colour to premultiplied colours (H, W, 3) with opacities (H, W): ``rgb + (1 - alpha) *
    background``. The kernel is used for tensors without a gradient."""
    if not _has_kernel(rgb, alpha) or rgb.requires_grad or alpha.requires_grad:
        return on_background(rgb, alpha, background)
    out = torch.empty(rgb.shape)
    colour = [float(each) for each in background]
    load_native().add_background(kernel_array(rgb), kernel_array(alpha), colour, *_execution(), kernel_array(out))
    return out


def resolve_samples(
    features: Tensor, alpha: Tensor, background: Sequence[float], samples: int
) -> tuple[Tensor, Tensor, Tensor]:
    """Compute the pixels of an image from ``samples`` x ``samples`` samples in each pixel.

    Args:
        features: (samples * H, samples * W, 4) rendered features, of which the first three are the colour.
        alpha: (samples * H, samples * W) opacities.
        background: RGB of the background.

    Returns:
        the mean colours (H, W, 3), the means of the last feature (H, W), and the mean colours on the background (H, W,
        3), all differentiable in ``features`` and ``alpha``.
    """
    if not _has_kernel(features, alpha):
        return resolve_samples_reference(features, alpha, background, samples)
    return _resolve(features, alpha, [float(each) for each in background], samples)


def mean_square(values: Tensor, truth: Tensor | None = None, first: int = 0) -> Tensor:
    """Compute the mean of the squared differences of two tensors (..., C), or of the squared values if ``truth`` is
    None. The components before ``first`` of the last axis do not count.

    The kernel is used only if ``truth`` requires no gradient.

    Returns:
        a scalar, differentiable in ``values`` and ``truth``.
    """
    tensors = (values,) if truth is None else (values, truth)
    if not _has_kernel(*tensors) or (truth is not None and (truth.requires_grad or truth.shape != values.shape)):
        return mean_square_reference(values, truth, first)
    return _mean_square(values, truth, first)


def clamped_error(values: Tensor, truth: Tensor) -> float:
    """Compute the mean squared difference of two images, of which the first is clamped to [0, 1]. It is not
    differentiable."""
    values, truth = values.detach(), truth.detach()
    if not _has_kernel(values, truth) or values.shape != truth.shape:
        return float((values.clamp(0, 1) - truth).square().mean())
    arrays = (_rows(values), _rows(truth))
    return float(load_native().mean_square(*arrays, 0, True, 1.0, *_execution(), None))


def _execution() -> tuple[int, str]:
    return thread_count(0, torch.get_num_threads()), simd_name()


def _has_kernel(*tensors: Tensor) -> bool:
    return all(each.device.type == "cpu" and each.dtype == torch.float32 and each.numel() > 0 for each in tensors)


def _rows(tensor: Tensor) -> Any:
    """Return a tensor (..., C) as an array (N, C)."""
    return as_array(tensor).reshape(-1, tensor.shape[-1])


def _empty_pixels(features: Tensor, samples: int) -> tuple[Tensor, Tensor, Tensor]:
    height, width = features.shape[0] // samples, features.shape[1] // samples
    shapes = ((height, width, 3), (height, width), (height, width, 3))
    colour, last, prediction = (uninitialised(features, *shape) for shape in shapes)
    return colour, last, prediction


@operator("fourd::resolve_samples", outputs=_empty_pixels, devices=("cpu",))
def _resolve(features: Tensor, alpha: Tensor, background: list[float], samples: int) -> tuple[Tensor, Tensor, Tensor]:
    out = _empty_pixels(features, samples)
    load_native().resolve_samples(
        kernel_array(features), kernel_array(alpha), background, samples, *_execution(), *map(kernel_array, out)
    )
    return out


def _empty_samples(height: int, width: int, like: Tensor) -> tuple[Tensor, Tensor]:
    return uninitialised(like, height, width, 4), uninitialised(like, height, width)


@operator("fourd::resolve_samples_backward", outputs=_empty_samples, devices=("cpu",))
def _resolve_backward(
    colour: Tensor | None,
    last: Tensor | None,
    prediction: Tensor | None,
    background: list[float],
    samples: int,
    height: int,
    width: int,
    like: Tensor,
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of features and alpha, with the given size and the dtype and the device of ``like``."""
    out = _empty_samples(height, width, like)
    given = [None if each is None else kernel_array(each) for each in (colour, last, prediction)]
    load_native().resolve_samples_backward(*given, background, samples, *_execution(), *map(kernel_array, out))
    return out


def _setup_resolve(ctx: Any, inputs: tuple[Tensor, Tensor, list[float], int], output: tuple[Tensor, ...]) -> None:
    features, _, ctx.background, ctx.samples = inputs
    ctx.set_materialize_grads(False)
    ctx.size = tuple(features.shape[:2])


def _backward_resolve(
    ctx: Any, colour: Tensor | None, last: Tensor | None, prediction: Tensor | None
) -> tuple[Tensor | None, Tensor | None, None, None]:
    given = [each for each in (colour, last, prediction) if each is not None]
    if not given:
        return None, None, None, None
    gradients = (colour, last, prediction)
    features, alpha = _resolve_backward(*gradients, ctx.background, ctx.samples, *ctx.size, given[0])
    return features, alpha, None, None


_resolve.register_autograd(_backward_resolve, setup_context=_setup_resolve)


@operator("fourd::mean_square", outputs=lambda values: uninitialised(values), devices=("cpu",))
def _mean_square(values: Tensor, truth: Tensor | None, first: int) -> Tensor:
    value = uninitialised(values)
    arrays = (_rows(values), None if truth is None else _rows(truth))
    as_array(value)[...] = load_native().mean_square(*arrays, first, False, 1.0, *_execution(), None)
    return value


@operator("fourd::mean_square_backward", outputs=lambda values: uninitialised(values, *values.shape), devices=("cpu",))
def _square_backward(values: Tensor, truth: Tensor | None, first: int, gradient: Tensor) -> Tensor:
    """Compute the gradient of the values. The forward pass does not, because it would need memory of the size of the
    values until then."""
    out = uninitialised(values, *values.shape)
    arrays = (_rows(values), None if truth is None else _rows(truth))
    upstream = float(as_array(gradient))
    load_native().mean_square(*arrays, first, False, upstream, *_execution(), _rows(out))
    return out


def _setup_square(ctx: Any, inputs: tuple[Tensor, Tensor | None, int], output: Tensor) -> None:
    values, truth, ctx.first = inputs
    ctx.save_for_backward(values, truth)


def _backward_square(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
    values, truth = ctx.saved_tensors
    return _square_backward(values, truth, ctx.first, gradient), None, None


_mean_square.register_autograd(_backward_square, setup_context=_setup_square)
