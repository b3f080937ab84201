"""Image term: the difference between rendered and true colours (4K4D, eq. 8)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from torch import Tensor
from torch.nn import functional

from fourd.reconstruction.training.losses.term import RenderedStep
from fourd.rendering.ops.step_images.op import mean_square

HUBER_DELTA = 0.1


@dataclass(frozen=True)
class ImageTerm:
    """Mean squared error or Huber loss of the colours."""

    penalty: Literal["mse", "huber"]
    name: str = "image"
    weight: float = 1.0

    def applies_to(self, step: RenderedStep) -> bool:
        return True

    def value(self, step: RenderedStep) -> Tensor:
        if self.penalty == "huber":
            return functional.huber_loss(step.prediction, step.truth, delta=HUBER_DELTA)
        return mean_square(step.prediction, step.truth)
