"""Adam on selected rows of tensors: the points that a step does not see keep their parameters and their state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from fourd.training.memory import tensor_outside_heap

BETAS = (0.9, 0.99)
EPSILON = 1e-15
EPSILONS = {"rgb": 1e-6}
"""Epsilon by parameter name, where it is not EPSILON. Most points' own colours have almost no influence on the picture:
with a smaller epsilon, gradients that are noise would make them a random walk."""


@dataclass
class SelectiveAdam:
    """State of Adam (Kingma and Ba 2015) with a step count for each row. N rows.

    Attributes:
        moments: parameter name -> (2, N, C) first and second moments.
        steps: (N,) float32, updates of each row.
    """

    moments: dict[str, Tensor]
    steps: Tensor

    @classmethod
    def initial(cls, parameters: Mapping[str, Tensor]) -> SelectiveAdam:
        """State before the first step for parameters (N, C)."""
        count = next(iter(parameters.values())).shape[0]
        moments = {name: torch.zeros(2, *value.shape) for name, value in parameters.items()}
        return cls(moments, torch.zeros(count))

    def step(
        self,
        parameters: Mapping[str, Tensor],
        rows: Tensor,
        gradients: Mapping[str, Tensor],
        rates: Mapping[str, float | Tensor],
    ) -> None:
        """Update ``rows`` of the parameters in place.

        Args:
            parameters: name -> (N, C).
            rows: (M,) indices, each at most once.
            gradients: name -> (M, C); parameters without one keep their values.
            rates: name -> learning rate in the parameter's units, a number or (M, 1).
        """
        self.steps[rows] += 1
        steps = self.steps[rows][:, None]
        for name, gradient in gradients.items():
            moments = self.moments[name]
            first = moments[0, rows].lerp(gradient, 1 - BETAS[0])
            second = moments[1, rows].lerp(gradient.square(), 1 - BETAS[1])
            moments[0, rows], moments[1, rows] = first, second
            scale = (second / (1 - BETAS[1] ** steps)).sqrt() + EPSILONS.get(name, EPSILON)
            parameters[name][rows] -= rates[name] * first / (1 - BETAS[0] ** steps) / scale

    def keep_rows(self, kept: Tensor, new_count: int) -> None:
        """Keep the state of rows ``kept`` (K,), and append initial state for ``new_count`` rows."""
        for name, moments in self.moments.items():
            new = torch.zeros(2, new_count, moments.shape[2])
            self.moments[name] = tensor_outside_heap(torch.cat([moments[:, kept], new], dim=1))
        self.steps = tensor_outside_heap(torch.cat([self.steps[kept], torch.zeros(new_count)]))
