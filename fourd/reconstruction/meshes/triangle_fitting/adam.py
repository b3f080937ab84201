"""Parameters that Adam updates, with one row per triangle or vertex. Rows can be removed and added."""

from __future__ import annotations

import torch
from torch import Tensor

from fourd.reconstruction.training.points.selective_adam import SelectiveAdam

BETAS = (0.9, 0.999)
_NAME = "value"


class AdamRows:
    """A parameter with T rows, and its optimizer state.

    Attributes:
        value: (T, ...) float32 leaf tensor that requires a gradient.
    """

    def __init__(self, value: Tensor, rate: float) -> None:
        """Start with the initial values ``value`` (T, ...) and the learning rate ``rate``."""
        self.value = value.detach().clone().requires_grad_()
        self._rate = rate
        self._adam = SelectiveAdam.initial({_NAME: _as_rows(value)}, BETAS)

    @torch.no_grad()
    def step(self, gradient: Tensor, factor: float = 1.0) -> None:
        """Update all rows with one Adam step, whose learning rate is multiplied by ``factor``."""
        parameters, gradients = {_NAME: _as_rows(self.value.detach())}, {_NAME: _as_rows(gradient)}
        self._adam.step(parameters, slice(None), gradients, {_NAME: self._rate * factor})

    @torch.no_grad()
    def replace(self, kept: Tensor, added: Tensor) -> None:
        """Keep the rows with the int64 indices ``kept``, and append the rows ``added`` with Adam moments of 0."""
        self.value = torch.cat([self.value[kept], added]).requires_grad_()
        self._adam.keep_rows(kept, len(added))


def _as_rows(tensor: Tensor) -> Tensor:
    """View a tensor (T, ...) as (T, C)."""
    return tensor.view(len(tensor), tensor[0].numel() if len(tensor) else 1)
