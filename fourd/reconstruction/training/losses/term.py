"""The interface of a loss term, and the data of a rendered step from which loss terms are computed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from fourd.reconstruction.training.schedule import StepSample


@dataclass(frozen=True)
class RenderedStep:
    """The rendered image of a training step, and the ground truth with which it is compared. Images are float32 in [0,
    1].

    Attributes:
        number: the number of the update. One update consists of one step per rank.
        time: time of the frame, in [0, 1].
        sample: the frame and views of the step.
        prediction: (H, W, 3) rendered image on the step's background colour.
        truth: (H, W, 3) true image on the step's background colour.
        coverage: (H, W) rendered alpha of the foreground or, if the target is a plate (an image of the empty scene), of
            the background.
        matte: (H, W) true alpha of the foreground, or None if the target is a plate.
        sh: (M, 3, 16) SH coefficients of the visible foreground points, or None if the target is a plate or the model
            uses no SH.
        displacement: (M, 3) learnt displacement of the visible points in world units, or None if there is no residual
            field.
    """

    number: int
    time: float
    sample: StepSample
    prediction: Tensor
    truth: Tensor
    coverage: Tensor
    matte: Tensor | None
    sh: Tensor | None
    displacement: Tensor | None


class LossTerm(Protocol):
    """One term of the training loss. Terms with weight 0 are not evaluated."""

    @property
    def name(self) -> str:
        """Name of the term in metrics and errors."""

    @property
    def weight(self) -> float:
        """Factor by which :meth:`value` is multiplied in the loss."""

    def applies_to(self, step: RenderedStep) -> bool:
        """Return true if the step has the data from which the term is computed."""

    def value(self, step: RenderedStep) -> Tensor:
        """Compute the term's value without its weight, as a differentiable scalar tensor."""


def term_values(terms: Iterable[LossTerm], step: RenderedStep) -> dict[str, Tensor]:
    """Compute the values of the loss terms that apply to the step, by name. The training loss is their sum, weighted by
    :attr:`LossTerm.weight`."""
    return {term.name: term.value(step) for term in terms if term.applies_to(step)}
