"""The Levenberg-Marquardt algorithm on the Rosenbrock function, and its rules."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from fourd.base.optimization.levenberg_marquardt import Rules, Trial, minimize

Array = NDArray[np.float64]
RULES = Rules(max_steps=100, max_trials=8, min_relative_decrease=1e-12)


@dataclass(frozen=True, eq=False)
class _Rosenbrock:
    """The function (1 - x)^2 + 100 (y - x^2)^2 near one point. ``damping`` records the factors of all steps."""

    xy: Array
    damping: list[float]
    last_below: float = 0.0

    @property
    def residual(self) -> Array:
        return np.array([1 - self.xy[0], 10 * (self.xy[1] - self.xy[0] ** 2)])

    @property
    def cost(self) -> float:
        return float(self.residual @ self.residual)

    def try_step(self, damping: float) -> Trial[Array]:
        self.damping.append(damping)
        jacobian = np.array([[-1, 0], [-20 * self.xy[0], 10]])
        matrix = jacobian.T @ jacobian * (1 + damping * np.eye(2))
        step = np.linalg.solve(matrix, -jacobian.T @ self.residual)
        after = replace(self, xy=self.xy + step)
        return Trial(after.xy, after.cost, bool(np.abs(step).max() < self.last_below))


def test_the_minimum_is_found() -> None:
    """Catches accepted steps that increase the cost, and an end far from the minimum."""
    found = minimize(lambda xy: _Rosenbrock(xy, []), np.array([-1.2, 1.0]), RULES)
    assert found == pytest.approx([1, 1], abs=1e-6)


def test_damping_follows_the_rules() -> None:
    """Catches a damping factor that is not raised after a rejected step, or starts again at each linearisation."""
    tried: list[float] = []
    rules = replace(RULES, max_steps=6, damping=1e-3, increase=20.0, decrease=5.0, min_damping=0.1)
    minimize(lambda xy: _Rosenbrock(xy, tried), np.array([-1.2, 1.0]), rules)
    assert tried[0] == 1e-3
    raised = [after == pytest.approx(20 * before) for before, after in pairwise(tried)]
    lowered = [after == max(before / 5, 0.1) for before, after in pairwise(tried)]
    assert any(raised)
    assert any(lowered)
    assert all(up or down for up, down in zip(raised, lowered, strict=True))


def test_the_limits_hold() -> None:
    """Catches more steps or trials than allowed, and an optimisation that continues after a negligible step."""
    start = np.array([-1.2, 1.0])
    tried: list[float] = []
    minimize(lambda xy: _Rosenbrock(xy, tried), start, Rules(3, 1, None))
    assert len(tried) == 3
    tried.clear()
    found = minimize(lambda xy: _Rosenbrock(xy, tried, last_below=np.inf), start, RULES)
    assert len(tried) == 1
    # The first step increases the cost.
    assert found is start


def test_a_cost_that_is_not_finite_ends_the_optimisation() -> None:
    """Catches an endless or accepted search from a state without a finite cost."""
    tried: list[float] = []
    start = np.array([np.nan, 1.0])
    assert minimize(lambda xy: _Rosenbrock(xy, tried), start, RULES) is start
    assert len(tried) == RULES.max_trials
