"""Shadow term: no shadow where no picture gives evidence of one."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from fourd.model.shadow import ShadowField
from fourd.training.background import StaticBackground
from fourd.training.losses.term import RenderedStep

STRIDE = 8
"""A step evaluates every STRIDE-th point of the background, seen by the target or not."""


@dataclass(frozen=True, eq=False)
class ShadowTerm:
    """Mean squared difference of the shadow factors from 1, in steps whose target is a frame."""

    weight: float
    background: StaticBackground
    field: ShadowField
    name: str = "shadow"

    def applies_to(self, step: RenderedStep) -> bool:
        return not step.sample.is_plate

    def value(self, step: RenderedStep) -> Tensor:
        subset = self.background.points.xyz[step.number % STRIDE :: STRIDE]
        return self.field.mean_squared_deviation(subset, step.time)
