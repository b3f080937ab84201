"""High-SH term: penalises large SH coefficients of degrees 2 and 3."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from fourd.reconstruction.model.point_model import LOW_SH_TERMS
from fourd.reconstruction.training.losses.term import RenderedStep
from fourd.rendering.ops.step_images.op import mean_square


@dataclass(frozen=True)
class HighShTerm:
    """Mean squared SH coefficient of degrees 2 and 3, over the visible foreground points.

    The penalty improves novel views. Because few training views see a point, its 16 coefficients per colour channel can
    overfit: those of high degrees would learn to compensate errors of the image-based colour in single views.
    """

    weight: float
    name: str = "high_sh"

    def applies_to(self, step: RenderedStep) -> bool:
        return step.sh is not None and len(step.sh) > 0

    def value(self, step: RenderedStep) -> Tensor:
        assert step.sh is not None
        return mean_square(step.sh, first=LOW_SH_TERMS)
