"""Several linear layers that have the same input, computed as one matrix product. The input is thus read only once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable


def shared_linear(features: Tensor, layers: Sequence[nn.Linear]) -> list[Tensor]:
    """Compute the outputs of all ``layers`` for ``features`` (N, F). The output of a layer of width M is a view (N, M)
    of one array that contains all outputs.

    The outputs equal those of separate layers, up to rounding errors from the order of summation. They are
    differentiable in features, weights and biases. Second derivatives are not supported.
    """
    parameters = [parameter for layer in layers for parameter in (layer.weight, layer.bias)]
    return list(_SharedLinear.apply(features, *parameters))


class _SharedLinear(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, features: Tensor, *weights_and_biases: Tensor) -> tuple[Tensor, ...]:
        weights = torch.cat(weights_and_biases[::2])
        ctx.widths = [bias.shape[0] for bias in weights_and_biases[1::2]]
        ctx.save_for_backward(features, weights)
        return torch.addmm(torch.cat(weights_and_biases[1::2]), features, weights.T).split(ctx.widths, dim=1)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, ...]:
        features, weights = ctx.saved_tensors
        gradient = torch.cat(gradients, dim=1)
        to_weights = (gradient.T @ features).split(ctx.widths)
        to_biases = gradient.sum(dim=0).split(ctx.widths)
        pairs = zip(to_weights, to_biases, strict=True)
        return gradient @ weights, *(part for pair in pairs for part in pair)
