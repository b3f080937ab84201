"""Mask term: the difference between rendered alpha and matte (4K4D, eq. 8)."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from fourd.reconstruction.training.losses.term import RenderedStep
from fourd.rendering.ops.step_images.op import mean_square


@dataclass(frozen=True)
class MaskTerm:
    """Mean squared difference between the rendered alpha of the foreground and the matte."""

    weight: float
    name: str = "mask"

    def applies_to(self, step: RenderedStep) -> bool:
        return step.matte is not None

    def value(self, step: RenderedStep) -> Tensor:
        assert step.matte is not None
        return mean_square(step.coverage, step.matte)
