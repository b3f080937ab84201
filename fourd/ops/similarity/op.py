"""Structural similarity as a loss: ``torch.ops.fourd.similarity``, value and gradient in one pass."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fourd.ops.loading import as_array, native, simd_name, thread_count
from fourd.training.evaluation.metrics import ssim


def similarity(prediction: Tensor, target: Tensor) -> Tensor:
    """What :func:`fourd.training.evaluation.metrics.ssim` gives for (H, W, C), by a kernel where there is one.

    That is for float32 on the CPU and a target that wants no gradient. The gradient is computed with the value,
    and is the same for any number of threads.

    Raises:
        ValueError: as :func:`fourd.training.evaluation.metrics.ssim`.
    """
    sound = prediction.ndim == 3 and prediction.shape == target.shape and min(prediction.shape[:2]) >= 11
    plain = all(tensor.dtype == torch.float32 and tensor.device.type == "cpu" for tensor in (prediction, target))
    if not sound or not plain or target.requires_grad:
        return ssim(prediction, target)
    wanted = prediction.requires_grad and torch.is_grad_enabled()
    return _similarity(prediction, target, wanted)[0]


@torch.library.custom_op("fourd::similarity", mutates_args=(), device_types="cpu")
def _similarity(prediction: Tensor, target: Tensor, with_gradient: bool) -> tuple[Tensor, Tensor]:
    """The similarity, and its gradient (H, W, C) with respect to the prediction; empty unless it is wanted."""
    gradient = torch.empty_like(prediction if with_gradient else prediction[:0], memory_format=torch.contiguous_format)
    threads = thread_count(0, torch.get_num_threads())
    out = as_array(gradient) if with_gradient else None
    value = native().similarity(as_array(prediction), as_array(target), threads, simd_name(), out)
    return prediction.new_tensor(value), gradient


@_similarity.register_fake
def _(prediction: Tensor, target: Tensor, with_gradient: bool) -> tuple[Tensor, Tensor]:
    gradient = torch.empty_like(prediction if with_gradient else prediction[:0], memory_format=torch.contiguous_format)
    return prediction.new_empty(()), gradient


def _setup(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
    ctx.set_materialize_grads(False)
    ctx.save_for_backward(output[1])


def _backward(ctx: Any, grad_value: Tensor | None, grad_gradient: Tensor | None) -> tuple[Tensor | None, None, None]:
    (gradient,) = ctx.saved_tensors
    return (None if grad_value is None else grad_value * gradient), None, None


_similarity.register_autograd(_backward, setup_context=_setup)
