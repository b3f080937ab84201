"""Refinement term: penalises large corrections of the target camera."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from fourd.reconstruction.training.cameras.refinement import Refinement
from fourd.reconstruction.training.losses.term import RenderedStep


@dataclass(frozen=True, eq=False)
class RefinementTerm:
    """Sum of (correction / standard deviation)^2 over all corrections of the target camera."""

    weight: float
    refinement: Refinement
    name: str = "refinement"

    def applies_to(self, step: RenderedStep) -> bool:
        return True

    def value(self, step: RenderedStep) -> Tensor:
        return self.refinement.penalty(step.sample.target).to(step.prediction)
