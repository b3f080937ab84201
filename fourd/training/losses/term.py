"""What a loss term is, and the record of a rendered step that terms evaluate."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from fourd.training.schedule import StepSample


@dataclass(frozen=True)
class RenderedStep:
    """What a step rendered, and what it is compared with. Pictures are float32 in [0, 1].

    Attributes:
        number: the step's number.
        time: of the frame, in [0, 1].
        sample: the step's frame and views.
        prediction: (H, W, 3) the rendered picture on the step's background colour.
        truth: (H, W, 3) the true picture on the same colour.
        coverage: (H, W) alpha of the first cloud: the foreground, or the background where the target is a plate.
        matte: (H, W) true alpha of the foreground; None where the target is a plate.
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
        """Name in metrics and errors."""

    @property
    def weight(self) -> float:
        """Factor on :meth:`value` in the loss."""

    def applies_to(self, step: RenderedStep) -> bool:
        """Whether the step has what the term needs."""

    def value(self, step: RenderedStep) -> Tensor:
        """The unweighted value, a differentiable scalar."""


def weighted_values(terms: Iterable[LossTerm], step: RenderedStep) -> dict[str, Tensor]:
    """Weighted values of the terms that apply to a step, by name; the loss is their sum."""
    return {term.name: term.weight * term.value(step) for term in terms if term.applies_to(step)}
