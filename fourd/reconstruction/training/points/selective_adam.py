"""Adam on selected rows of tensors, so that points that are not visible in a step keep their parameters and optimizer
state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from fourd.reconstruction.training.memory import tensor_outside_heap
from fourd.rendering.ops.moves import adam_rows, has_kernels

BETAS = (0.9, 0.99)
EPSILON = 1e-15
EPSILONS = {"rgb": 1e-6}
"""Parameter name -> Adam's epsilon, for parameters that do not use EPSILON. The stored colours ("rgb") of most
background points hardly affect the image, so their gradients are mostly noise. If their epsilon were as small as
EPSILON, Adam would take full-size steps on this noise, and the colours would follow a random walk."""


@dataclass
class SelectiveAdam:
    """State of Adam (Kingma and Ba 2015) for N rows, with a step count for each row.

    Attributes:
        moments: parameter name -> first and second moments (2, N, C).
        steps: (N,) float32, number of updates of each row.
        betas: decay rates of the first and second moments.
    """

    moments: dict[str, Tensor]
    steps: Tensor
    betas: tuple[float, float] = BETAS

    @classmethod
    def initial(cls, parameters: Mapping[str, Tensor], betas: tuple[float, float] = BETAS) -> SelectiveAdam:
        """Create the initial state for parameters (N, C)."""
        count = next(iter(parameters.values())).shape[0]
        moments = {name: torch.zeros(2, *value.shape) for name, value in parameters.items()}
        return cls(moments, torch.zeros(count), betas)

    def step(
        self,
        parameters: Mapping[str, Tensor],
        rows: Tensor | slice,
        gradients: Mapping[str, Tensor],
        rates: Mapping[str, float | Tensor],
    ) -> None:
        """Update ``rows`` of the parameters in place.

        Args:
            parameters: name -> parameters (N, C).
            rows: (M,) indices of the rows to update, without duplicates, or a slice of the rows.
            gradients: name -> gradients (M, C), in which NaN counts as 0. Parameters without a gradient keep their
                values.
            rates: name -> learning rate in the parameter's units, as one number or as a tensor (M, 1).
        """
        epsilons = {name: EPSILONS.get(name, EPSILON) for name in gradients}
        arrays = [*gradients.values(), *(parameters[name] for name in gradients)]
        if isinstance(rows, Tensor) and has_kernels(rows, self.steps, *arrays):
            adam_rows(rows, self.steps, parameters, self.moments, gradients, rates, epsilons, self.betas)
            return
        gradients = {name: torch.nan_to_num(gradient) for name, gradient in gradients.items()}
        self.steps[rows] += 1
        steps = self.steps[rows][:, None]
        for name, gradient in gradients.items():
            moments = self.moments[name]
            first = moments[0, rows].lerp(gradient, 1 - self.betas[0])
            second = moments[1, rows].lerp(gradient.square(), 1 - self.betas[1])
            moments[0, rows], moments[1, rows] = first, second
            scale = (second / (1 - self.betas[1] ** steps)).sqrt() + epsilons[name]
            parameters[name][rows] -= rates[name] * first / (1 - self.betas[0] ** steps) / scale

    def keep_rows(self, kept: Tensor, new_count: int) -> None:
        """Keep only the state of the rows ``kept`` (K,), and append the initial state of ``new_count`` rows."""
        for name, moments in self.moments.items():
            new = moments.new_zeros(2, new_count, moments.shape[2])
            self.moments[name] = tensor_outside_heap(torch.cat([moments[:, kept], new], dim=1))
        self.steps = tensor_outside_heap(torch.cat([self.steps[kept], self.steps.new_zeros(new_count)]))
