"""The stylizer's time as a part of the time per image."""

from __future__ import annotations

import pytest

from fourd.viewer.timings import PARTS, Timings


def test_the_time_of_the_stylizer_is_taken_from_another_part() -> None:
    """Catches a time that counts twice in the plot, and a part with a time below 0."""
    timings = Timings()
    with timings.measure("draw"):
        sum(range(200_000))
    timings.finish_image()
    drawn = timings.medians()["draw"]
    for _ in range(2):
        with timings.measure("draw"):
            sum(range(200_000))
        timings.move("draw", "style", 1e-6 * drawn)
        timings.finish_image()
    last = dict(zip(PARTS, timings.cumulative()[-1], strict=True))
    assert last["style"] - last["draw"] == pytest.approx(1e-3 * drawn)
    with timings.measure("draw"):
        sum(range(200_000))
    timings.move("draw", "style", 1000.0)
    timings.finish_image()
    draw, style, *_ = timings.cumulative()[-1]
    assert draw == 0
    assert 0 < style < 1e6
