"""High-SH term: penalises large SH coefficients of the degrees 2 and 3."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from fourd.model.point_model import LOW_SH_TERMS
from fourd.training.losses.term import RenderedStep


@dataclass(frozen=True)
class HighShTerm:
    """Mean squared SH coefficient of the degrees 2 and 3, over the visible foreground points.

    A point is seen by few training views and has 16 coefficients for each colour channel. Without a penalty, the
    coefficients of high degrees reproduce errors of the image-based colour in single views, and new views become worse.
    """

    weight: float
    name: str = "high_sh"

    def applies_to(self, step: RenderedStep) -> bool:
        return step.sh is not None and len(step.sh) > 0

    def value(self, step: RenderedStep) -> Tensor:
        assert step.sh is not None
        return step.sh[..., LOW_SH_TERMS:].square().mean()
