"""Perceptual term: LPIPS distance between the rendered and the true image (4K4D, eq. 8)."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from fourd.reconstruction.training.losses.lpips import LPIPS
from fourd.reconstruction.training.losses.term import RenderedStep


@dataclass(frozen=True, eq=False)
class PerceptualTerm:
    """LPIPS (VGG-16)."""

    weight: float
    network: LPIPS
    name: str = "lpips"

    def applies_to(self, step: RenderedStep) -> bool:
        return True

    def value(self, step: RenderedStep) -> Tensor:
        return self.network(step.prediction, step.truth)
