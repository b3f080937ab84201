"""Shadow term: penalises all shadows, so that the model learns only shadows that the images show."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from fourd.reconstruction.model.shadow import ShadowField
from fourd.reconstruction.training.background import StaticBackground
from fourd.reconstruction.training.losses.term import RenderedStep

STRIDE = 8
"""The shadow term uses every STRIDE-th background point, including points that are not visible in the target view."""


@dataclass(frozen=True, eq=False)
class ShadowTerm:
    """Mean of (f - 1)^2, where f is the shadow factor of a background point and f = 1 means no shadow. The term applies
    to steps whose target is an image of a frame, and not a plate (an image of the empty scene)."""

    weight: float
    background: StaticBackground
    field: ShadowField
    name: str = "shadow"

    def applies_to(self, step: RenderedStep) -> bool:
        return not step.sample.is_plate

    def value(self, step: RenderedStep) -> Tensor:
        subset = self.background.points.xyz[step.number % STRIDE :: STRIDE]
        return self.field.mean_squared_deviation(subset, step.time)
