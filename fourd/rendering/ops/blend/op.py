"""Blend logits of source views: the operator ``torch.ops.fourd.blend_logits`` and its gradient."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.blend.reference import LOGIT_RANGE, blend_logits_reference
from fourd.rendering.ops.loading import as_array, load_native, simd_name, thread_count
from fourd.rendering.ops.operator import operator


def blend_logits(point: Tensor, samples: Tensor, weight: Tensor, out: Tensor, bias: Tensor) -> Tensor:
    """Compute ``5 * tanh((out . relu(point + weight @ sample) + bias) / 5)`` for every point and source view.

    This is the blend MLP of 4K4D (sec. 3.2). The argument ``point`` is the part of the first layer that depends only on
    the point and is therefore the same for all views. Float32 inputs on the CPU use a kernel that does not store the
    hidden layer. Other inputs use :func:`fourd.rendering.ops.blend.reference.blend_logits_reference`.

    Args:
        point: (N, H) contribution of each point to the hidden layer, with H from 1 to 256.
        samples: (V, C, N) image features and colours of each view, sampled at each point's projection, with C from 1 to
            64.
        weight: (H, C) weights from the samples to the hidden layer.
        out: (H,) weights from the hidden layer to the output.
        bias: (1,) bias of the output.

    Returns:
        (V, N) logits in [-5, 5], differentiable in all arguments. The gradient is bit-identical for any number of
        threads.

    Raises:
        ValueError: if shapes do not match.
    """
    if point.device.type != "cpu" or point.dtype != torch.float32:
        return blend_logits_reference(point, samples, weight, out, bias)
    return _logits(point, samples, weight, out, bias)


def _arguments(point: Tensor, samples: Tensor, weight: Tensor, out: Tensor, bias: Tensor) -> list[Any]:
    arrays = [as_array(point), as_array(samples), as_array(weight.T), as_array(out)]
    return [*arrays, float(bias), LOGIT_RANGE, thread_count(0, torch.get_num_threads()), simd_name()]


@operator(
    "fourd::blend_logits",
    outputs=lambda point, samples: point.new_empty(samples.shape[0], point.shape[0]),
    devices=("cpu",),
)
def _logits(point: Tensor, samples: Tensor, weight: Tensor, out: Tensor, bias: Tensor) -> Tensor:
    logits = point.new_empty(samples.shape[0], point.shape[0])
    load_native().blend_logits(*_arguments(point, samples, weight, out, bias), as_array(logits))
    return logits


@operator(
    "fourd::blend_logits_backward",
    outputs=lambda point, samples, weight, out, bias: _empty_gradients(point, samples, weight, out, bias),
    devices=("cpu",),
)
def _logits_backward(
    point: Tensor, samples: Tensor, weight: Tensor, out: Tensor, bias: Tensor, logits: Tensor, gradient: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    gradients = _empty_gradients(point, samples, weight, out, bias)
    # The kernel expects the transposed weight matrix and returns the transposed gradient of the weights.
    grad_weight = weight.new_empty(weight.shape[1], weight.shape[0])
    targets = [gradients[0], gradients[1], grad_weight, gradients[3], gradients[4]]
    load_native().blend_logits_backward(
        *_arguments(point, samples, weight, out, bias),
        as_array(logits),
        as_array(gradient),
        *[as_array(target) for target in targets],
    )
    gradients[2].copy_(grad_weight.T)
    return gradients


def _setup(ctx: Any, inputs: tuple[Tensor, ...], output: Tensor) -> None:
    ctx.save_for_backward(*inputs, output)


def _backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, ...]:
    return _logits_backward(*ctx.saved_tensors, gradient)


_logits.register_autograd(_backward, setup_context=_setup)


def _empty_gradients(
    point: Tensor, samples: Tensor, weight: Tensor, out: Tensor, bias: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    layout = torch.contiguous_format
    return (
        torch.empty_like(point, memory_format=layout),
        torch.empty_like(samples, memory_format=layout),
        torch.empty_like(weight, memory_format=layout),
        torch.empty_like(out, memory_format=layout),
        torch.empty_like(bias, memory_format=layout),
    )
