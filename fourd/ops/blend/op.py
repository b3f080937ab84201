"""Logits of source views: ``torch.ops.fourd.blend_logits``, its gradient, and the same in plain torch."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fourd.ops.loading import as_array, native, simd_name, thread_count

LOGIT_RANGE = 5.0


def blend_logits(point: Tensor, samples: Tensor, weight: Tensor, out: Tensor, bias: Tensor) -> Tensor:
    """``5 tanh((out . relu(point + weight sample) + bias) / 5)`` of every point and source view.

    The range is bounded so that exponentials of baked logits fit into fp16. In float32 on the CPU a
    kernel computes it, which never stores the hidden layer of all views and points; else
    :func:`blend_logits_reference`.

    Args:
        point: (N, H) what the point alone gives to the hidden layer, H from 1 to 256.
        samples: (V, C, N) what the views hold at the points, C from 1 to 64.
        weight: (H, C) of the hidden layer, for the samples.
        out: (H,) and bias: (1,) of the output.

    Returns:
        (V, N) logits in +-5, differentiable in everything. The gradient is the same for any number
        of threads.

    Raises:
        ValueError: for shapes that do not fit.
    """
    if point.device.type != "cpu" or point.dtype != torch.float32:
        return blend_logits_reference(point, samples, weight, out, bias)
    return _logits(point, samples, weight, out, bias)


def blend_logits_reference(point: Tensor, samples: Tensor, weight: Tensor, out: Tensor, bias: Tensor) -> Tensor:
    """What :func:`blend_logits` promises, in plain torch; any device and dtype."""
    hidden = torch.relu(point + samples.transpose(1, 2) @ weight.T)
    return LOGIT_RANGE * torch.tanh((hidden @ out + bias) / LOGIT_RANGE)


def _arguments(point: Tensor, samples: Tensor, weight: Tensor, out: Tensor, bias: Tensor) -> list[Any]:
    arrays = [as_array(point), as_array(samples), as_array(weight.T), as_array(out)]
    return [*arrays, float(bias), LOGIT_RANGE, thread_count(0, torch.get_num_threads()), simd_name()]


@torch.library.custom_op("fourd::blend_logits", mutates_args=(), device_types="cpu")
def _logits(point: Tensor, samples: Tensor, weight: Tensor, out: Tensor, bias: Tensor) -> Tensor:
    logits = point.new_empty(samples.shape[0], point.shape[0])
    native().blend_logits(*_arguments(point, samples, weight, out, bias), logits.numpy())
    return logits


@_logits.register_fake
def _(point: Tensor, samples: Tensor, weight: Tensor, out: Tensor, bias: Tensor) -> Tensor:
    return point.new_empty(samples.shape[0], point.shape[0])


@torch.library.custom_op("fourd::blend_logits_backward", mutates_args=(), device_types="cpu")
def _logits_backward(
    point: Tensor, samples: Tensor, weight: Tensor, out: Tensor, bias: Tensor, logits: Tensor, gradient: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    made = _empty(point, samples, weight, out, bias)
    to_weight = weight.new_empty(weight.shape[1], weight.shape[0])
    targets = [made[0], made[1], to_weight, made[3], made[4]]
    native().blend_logits_backward(
        *_arguments(point, samples, weight, out, bias),
        as_array(logits),
        as_array(gradient),
        *[t.numpy() for t in targets],
    )
    made[2].copy_(to_weight.T)
    return made


@_logits_backward.register_fake
def _(
    point: Tensor, samples: Tensor, weight: Tensor, out: Tensor, bias: Tensor, logits: Tensor, gradient: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    return _empty(point, samples, weight, out, bias)


def _setup(ctx: Any, inputs: tuple[Tensor, ...], output: Tensor) -> None:
    ctx.save_for_backward(*inputs, output)


def _backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, ...]:
    return _logits_backward(*ctx.saved_tensors, gradient)


_logits.register_autograd(_backward, setup_context=_setup)


def _empty(
    point: Tensor, samples: Tensor, weight: Tensor, out: Tensor, bias: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    dense = torch.contiguous_format
    return (
        torch.empty_like(point, memory_format=dense),
        torch.empty_like(samples, memory_format=dense),
        torch.empty_like(weight, memory_format=dense),
        torch.empty_like(out, memory_format=dense),
        torch.empty_like(bias, memory_format=dense),
    )
