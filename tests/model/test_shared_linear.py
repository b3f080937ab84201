"""Shared linear layers compared with separate layers."""

from __future__ import annotations

import numpy as np
import torch
from torch import nn

from fourd.reconstruction.model.shared_linear import shared_linear


def test_values_and_gradients_equal_those_of_separate_layers(rng: np.random.Generator) -> None:
    """Catches a layer's gradient that reaches another layer, also if only some of the outputs are used."""
    torch.manual_seed(int(rng.integers(2**31)))
    layers = [nn.Linear(12, width).double() for width in (5, 1, 7)]
    features = torch.randn(40, 12, dtype=torch.float64, requires_grad=True)
    leaves = [features, *(part for layer in layers for part in (layer.weight, layer.bias))]
    for used in ((0, 1, 2), (0, 2), (1,)):
        results = []
        for outputs in (shared_linear(features, layers), [layer(features) for layer in layers]):
            total = sum((outputs[index].relu().square().sum() for index in used), start=torch.zeros(()))
            gradients = torch.autograd.grad(total, leaves, materialize_grads=True, allow_unused=True)
            results.append([*(output.detach() for output in outputs), *gradients])
        for found, expected in zip(*results, strict=True):
            torch.testing.assert_close(found, expected)
