"""The schedule and the budget of a fit, and invalid settings."""

from __future__ import annotations

import pytest

from fourd.reconstruction.meshes.triangle_fitting.schedule import Budget, phase_at, surface_rate
from fourd.reconstruction.meshes.triangle_fitting.settings import TriangleSettings


def test_triangles_end_opaque() -> None:
    """Catches a schedule that jumps between the phases, or ends with translucent triangles."""
    settings = TriangleSettings(max_steps=1, soft_share=0.4, hard_share=0.8)
    soft = phase_at(0.39, settings)
    assert (soft.sigma, soft.floor, soft.grows) == (1.16, 0.0, True)
    first, middle, last = (phase_at(share, settings) for share in (0.4, 0.6, 0.8))
    assert not first.grows
    assert (first.sigma, first.floor) == pytest.approx((1.16, 0.1))
    assert first.sigma > middle.sigma > last.sigma
    assert (last.sigma, last.floor) == pytest.approx((1e-4, 0.9999))
    assert surface_rate(0.8, settings) == 1
    assert surface_rate(1.0, settings) == pytest.approx(0.1)
    assert phase_at(0.5, TriangleSettings(max_steps=1, soft_share=0.5, hard_share=0.5)).floor == pytest.approx(0.9999)


def test_the_first_limit_ends_the_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a limit of steps or seconds that is ignored if both limits are given, and a pause that uses up time."""
    clock = [0.0]
    monkeypatch.setattr("fourd.reconstruction.meshes.triangle_fitting.schedule.monotonic", lambda: clock[0])
    budget = Budget(10, 100.0)
    assert budget.share == 0
    budget.steps = 5
    assert budget.share == pytest.approx(0.5)
    clock[0] = 80.0
    assert budget.share == pytest.approx(0.8)
    with budget.paused():
        clock[0] = 200.0
    assert budget.share == pytest.approx(0.8)
    budget.steps = 20
    assert budget.share == 1
    other = Budget(None, 1000.0)
    other.close()
    assert other.share == 1


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"triangles": 8}, "triangles: expected at least 16, got 8"),
        ({"max_steps": None}, "max_steps: expected a limit of steps or seconds, got neither"),
        ({"max_steps": 0}, "max_steps: expected at least 1, got 0"),
        ({"max_seconds": float("nan")}, "max_seconds: expected a number of seconds above 0, got nan"),
        ({"soft_share": 0.5, "hard_share": 0.4}, "expected 0 <= soft_share <= hard_share <= 1, got 0.5 and 0.4"),
        ({"plane": -1.0}, "plane: expected a weight of 0 or more, got -1"),
    ],
)
def test_invalid_settings_are_named(values: dict[str, float], message: str) -> None:
    """Catches a setting out of range that causes an error only during the fit."""
    with pytest.raises(ValueError, match=message.replace("[", r"\[").replace("(", r"\(")):
        TriangleSettings(**{"max_steps": 5} | values)  # type: ignore[arg-type]
