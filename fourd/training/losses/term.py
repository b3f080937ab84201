"""The interface of a loss term, and the record of a rendered step on which terms are evaluated."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from fourd.training.schedule import StepSample


@dataclass(frozen=True)
class RenderedStep:
    """The rendered image of a step, and the ground truth with which it is compared. Images are float32 in [0, 1].

    Attributes:
        number: the number of the step.
        time: time of the frame, in [0, 1].
        sample: the frame and views of the step.
        prediction: (H, W, 3) rendered image on the step's background colour.
        truth: (H, W, 3) true image on the same background colour.
        coverage: (H, W) rendered alpha of the foreground, or of the background if the target is a plate.
        matte: (H, W) true alpha of the foreground; None if the target is a plate.
        displacement: (M, 3) learnt displacement of the visible points in world units; None without a residual field.
    """

    number: int
    time: float
    sample: StepSample
    prediction: Tensor
    truth: Tensor
    coverage: Tensor
    matte: Tensor | None
    displacement: Tensor | None


class LossTerm(Protocol):
    """One term of the loss. Terms with weight 0 are not evaluated."""

    @property
    def name(self) -> str:
        """Name of the term in metrics and errors."""

    @property
    def weight(self) -> float:
        """Factor by which :meth:`value` is multiplied in the loss."""

    def applies_to(self, step: RenderedStep) -> bool:
        """Whether the step contains the data that the term needs."""

    def value(self, step: RenderedStep) -> Tensor:
        """The value before weighting, a differentiable scalar."""


def weighted_values(terms: Iterable[LossTerm], step: RenderedStep) -> dict[str, Tensor]:
    """Name -> weighted value of each term that applies to a step. The loss is the sum of the values."""
    return {term.name: term.weight * term.value(step) for term in terms if term.applies_to(step)}
