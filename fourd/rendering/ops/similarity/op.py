"""Structural similarity (SSIM) as a loss: the operator ``torch.ops.fourd.similarity``, which computes value and
gradient in one pass."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.loading import as_array, load_native, simd_name, thread_count
from fourd.rendering.ops.operator import kernel_array, operator, uninitialised
from fourd.rendering.ops.similarity.reference import WINDOW_PX, structural_similarity_reference


def structural_similarity(prediction: Tensor, target: Tensor) -> Tensor:
    """Compute the structural similarity of two (H, W, C) images.

    See :func:`fourd.rendering.ops.similarity.reference.structural_similarity_reference` for the definition.

    Float32 images on the CPU use a kernel if the target requires no gradient; other inputs use the reference. The
    kernel computes value and gradient together, and both are bit-identical for any number of threads.

    Returns:
        The similarity as a scalar, differentiable in both images.

    Raises:
        ValueError: for different shapes, integer images, or an image smaller than the window.
    """
    fits = prediction.ndim == 3 and prediction.shape == target.shape and min(prediction.shape[:2]) >= WINDOW_PX
    has_kernel = all(tensor.dtype == torch.float32 and tensor.device.type == "cpu" for tensor in (prediction, target))
    if not fits or not has_kernel or target.requires_grad:
        return structural_similarity_reference(prediction, target)
    needs_gradient = prediction.requires_grad and torch.is_grad_enabled()
    return _similarity(prediction, target, needs_gradient)[0]


@operator(
    "fourd::similarity",
    outputs=lambda prediction, with_gradient: (uninitialised(prediction), _empty_gradient(prediction, with_gradient)),
    devices=("cpu",),
)
def _similarity(prediction: Tensor, target: Tensor, with_gradient: bool) -> tuple[Tensor, Tensor]:
    """Return the similarity and its gradient (H, W, C) with respect to the prediction. The gradient is an empty tensor
    if ``with_gradient`` is False.
    """
    gradient = _empty_gradient(prediction, with_gradient)
    threads = thread_count(0, torch.get_num_threads())
    out = kernel_array(gradient) if with_gradient else None
    value = uninitialised(prediction)
    as_array(value)[...] = load_native().similarity(
        kernel_array(prediction), kernel_array(target), threads, simd_name(), out
    )
    return value, gradient


def _setup(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
    ctx.set_materialize_grads(False)
    ctx.save_for_backward(output[1])


def _backward(ctx: Any, grad_value: Tensor | None, grad_gradient: Tensor | None) -> tuple[Tensor | None, None, None]:
    (gradient,) = ctx.saved_tensors
    return (None if grad_value is None else grad_value * gradient), None, None


_similarity.register_autograd(_backward, setup_context=_setup)


def _empty_gradient(prediction: Tensor, with_gradient: bool) -> Tensor:
    return uninitialised(prediction, *(prediction.shape if with_gradient else (0,)))
