"""Adam (Kingma and Ba 2015) for parameters whose rows are removed and added."""

from __future__ import annotations

import torch
from torch import Tensor

DECAYS = (0.9, 0.999)
EPSILON = 1e-15


class AdamRows:
    """A parameter with one row per triangle, and its moments.

    Attributes:
        value: (T, ...) float32 leaf tensor that requires a gradient.
    """

    def __init__(self, value: Tensor, rate: float) -> None:
        """Start with ``value`` (T, ...). ``rate`` is the learning rate."""
        self.value = value.detach().clone().requires_grad_()
        self._rate = rate
        self._mean = torch.zeros_like(value)
        self._square = torch.zeros_like(value)
        self._steps = torch.zeros(len(value))

    @torch.no_grad()
    def step(self, gradient: Tensor, factor: float = 1.0) -> None:
        """Move all rows by one step. ``factor`` scales the learning rate."""
        first, second = DECAYS
        self._steps += 1
        self._mean.lerp_(gradient, 1 - first)
        self._square.mul_(second).addcmul_(gradient, gradient, value=1 - second)
        shape = (-1, *[1] * (self.value.ndim - 1))
        bias = ((1 - second**self._steps).sqrt() / (1 - first**self._steps)).reshape(shape)
        self.value.sub_(self._mean / (self._square.sqrt() + EPSILON) * (bias * (self._rate * factor)))

    @torch.no_grad()
    def replace(self, kept: Tensor, added: Tensor) -> None:
        """Keep the rows ``kept`` (int64 indices), and append the rows ``added`` with moments of 0."""
        self.value = torch.cat([self.value[kept], added]).requires_grad_()
        zeros = torch.zeros_like(added)
        self._mean = torch.cat([self._mean[kept], zeros])
        self._square = torch.cat([self._square[kept], zeros])
        self._steps = torch.cat([self._steps[kept], torch.zeros(len(added))])
