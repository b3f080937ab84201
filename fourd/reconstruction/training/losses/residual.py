"""Residual term: penalises large displacements that the residual field adds to the points' positions."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from fourd.reconstruction.training.losses.term import RenderedStep


@dataclass(frozen=True)
class ResidualTerm:
    """Mean of the squared components of the displacements that the residual field adds to the positions of the visible
    points. The displacements are in units of the point spacing."""

    weight: float
    spacing: float
    name: str = "residual"

    def applies_to(self, step: RenderedStep) -> bool:
        return step.displacement is not None and len(step.displacement) > 0

    def value(self, step: RenderedStep) -> Tensor:
        assert step.displacement is not None
        return (step.displacement / self.spacing).square().mean()
