"""Mask term: rendered alpha against the matte (4K4D, eq. 8)."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor
from torch.nn import functional

from fourd.training.losses.term import RenderedStep


@dataclass(frozen=True)
class MaskTerm:
    """Mean squared difference between the foreground's rendered alpha and its matte."""

    weight: float
    name: str = "mask"

    def applies_to(self, step: RenderedStep) -> bool:
        return step.matte is not None

    def value(self, step: RenderedStep) -> Tensor:
        assert step.matte is not None
        return functional.mse_loss(step.coverage, step.matte)
