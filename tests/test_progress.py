"""Progress output on a terminal and in a file."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator

import pytest
from rich.console import Console

from fourd.base.progress import EndEstimate, Tracker, format_duration


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A clock that is controlled by tests. The only element of the list is the time in seconds."""
    now = [100.0]
    monkeypatch.setattr("fourd.base.progress.monotonic", lambda: now[0])
    return now


def logged_lines(count: int, seconds: float, clock: list[float]) -> list[str]:
    """The progress lines in a file for ``count`` items that take ``seconds`` each."""
    text = io.StringIO()
    for _ in Tracker(Console(file=text, width=40)).track(range(count), count, "mattes"):
        clock[0] += seconds
    return text.getvalue().splitlines()


def test_file_gets_lines_with_the_remaining_time(clock: list[float]) -> None:
    """Catches progress output without a line for hours, progress output with a line for each item, and wrong remaining
    times.
    """
    lines = logged_lines(100, 1.0, clock)
    assert lines == [
        "mattes: 30 of 100 after 0:00:30, 0:01:10 left",
        "mattes: 60 of 100 after 0:01:00, 0:00:40 left",
        "mattes: 90 of 100 after 0:01:30, 0:00:10 left",
        "mattes: 100 of 100 after 0:01:40",
    ]


def test_short_phases_have_no_line(clock: list[float]) -> None:
    """Catches progress lines for phases that take almost no time, and a division by zero if there are no items."""
    assert logged_lines(10, 0.1, clock) == []
    assert logged_lines(0, 1.0, clock) == []
    assert logged_lines(1, 5.0, clock) == ["mattes: 1 of 1 after 0:00:05"]


def test_items_that_finish_together_do_not_change_the_estimate() -> None:
    """Catches a rate that is measured between two consecutive results, which is wrong if processes finish items in
    groups."""
    estimate = EndEstimate(0.0, 100)
    assert [estimate.update(20.0, 1), estimate.update(20.0, 2)] == [2000.0, 1000.0]
    ends = [estimate.update(20.0 * turn, 2 * turn - 1 + second) for turn in range(2, 40) for second in (0, 1)]
    assert max(abs(end - 1000) for end in ends[1::2]) < 1e-6
    assert max(abs(end - 1000) for end in ends[20::2]) < 60


def test_estimate_follows_a_slower_machine() -> None:
    """Catches a remaining time that is far too short after the work slows to a tenth, because the mean rate of the
    whole work is used."""
    estimate = EndEstimate(0.0, 20_000)
    for done in range(1, 10_001):
        estimate.update(0.1 * done, done)
    slow = [estimate.update(1000.0 + number, 10_000 + number) for number in range(1, 121)]
    assert slow[-1] == pytest.approx(1000 + 10_000)


def test_terminal_shows_count_and_remaining_time() -> None:
    """Catches a progress bar without a count or remaining time, and a progress bar that remains on the screen at the
    end."""
    text = io.StringIO()
    console = Console(file=text, width=100, force_terminal=True, _environ={})

    def slow() -> Iterator[int]:
        yield from range(3)

    seen = []
    for item in Tracker(console).track(slow(), 3, "looking"):
        seen.append(item)
    assert seen == [0, 1, 2]
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text.getvalue())
    assert re.search(r"looking .*3/3 0:00:00 0:00:00", plain)
    assert text.getvalue().endswith("\x1b[2K")


def test_durations_have_hours_and_are_not_negative() -> None:
    """Catches a negative remaining time."""
    assert format_duration(3 * 3600 + 62) == "3:01:02"
    assert format_duration(-4.0) == "0:00:00"
