"""The Levenberg-Marquardt algorithm (Marquardt, An Algorithm for Least-Squares Estimation of Nonlinear Parameters,
1963), for any state and any way to solve the normal equations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

State = TypeVar("State")


@dataclass(frozen=True)
class Rules:
    """Rules for the damping and for the end of an optimisation.

    Attributes:
        max_steps: maximum number of linearisations.
        max_trials: maximum number of trials, with increasing damping, per linearisation.
        min_relative_decrease: the optimisation ends when the accepted step of a linearisation decreases the cost by at
            most this fraction of the cost, or no trial is accepted. If None, only ``max_steps`` and ``Trial.is_last``
            end it.
        damping: initial damping factor.
        decrease: the damping factor is divided by this number after an accepted trial.
        increase: the damping factor is multiplied by this number after a rejected trial.
        min_damping: smallest damping factor after an accepted trial.
    """

    max_steps: int
    max_trials: int
    min_relative_decrease: float | None
    damping: float = 1e-3
    decrease: float = 10.0
    increase: float = 10.0
    min_damping: float = 0.0


@dataclass(frozen=True, eq=False)
class Trial(Generic[State]):
    """The result of one step.

    Attributes:
        state: the state after the step.
        cost: the cost of ``state``, or infinity to reject the step.
        is_last: whether the step is so small that the optimisation ends with it.
    """

    state: State
    cost: float
    is_last: bool = False


class Model(Protocol[State]):
    """A quadratic model of the cost near one state."""

    @property
    def cost(self) -> float:
        """The cost at the state."""

    def try_step(self, damping: float) -> Trial[State]:
        """Make the step that minimises the model, damped by the factor ``damping``."""


def minimize(linearize: Callable[[State], Model[State]], start: State, rules: Rules) -> State:
    """Minimise a sum of squares from the state ``start``, and return the state with the smallest cost.

    A trial is accepted if it decreases the cost. ``linearize`` returns the model at a state.
    """
    state, damping = start, rules.damping
    for _ in range(rules.max_steps):
        model = linearize(state)
        decrease, is_last = 0.0, False
        for _ in range(rules.max_trials):
            trial = model.try_step(damping)
            is_last = trial.is_last
            if trial.cost < model.cost:
                state, decrease = trial.state, model.cost - trial.cost
                damping = max(damping / rules.decrease, rules.min_damping)
                break
            damping *= rules.increase
            if is_last:
                break
        if is_last:
            break
        # The comparison is false for a cost that is not a number, which no step can decrease.
        if rules.min_relative_decrease is not None and not decrease > rules.min_relative_decrease * model.cost:
            break
    return state
