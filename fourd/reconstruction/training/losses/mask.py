"""Mask term: the difference between rendered alpha and matte (4K4D, eq. 8)."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor
from torch.nn import functional

from fourd.reconstruction.training.losses.term import RenderedStep


@dataclass(frozen=True)
class MaskTerm:
    """Mean squared difference between the rendered alpha of the foreground and the matte."""

    weight: float
    name: str = "mask"

    def applies_to(self, step: RenderedStep) -> bool:
        return step.matte is not None

    def value(self, step: RenderedStep) -> Tensor:
        assert step.matte is not None
        return functional.mse_loss(step.coverage, step.matte)
