"""What stages show of their progress, on a terminal and in a file."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator

import pytest
from rich.console import Console

from fourd.progress import Pace, Tracker, clock


@pytest.fixture
def passed(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A clock that stands still until a test moves its only element, in seconds."""
    now = [100.0]
    monkeypatch.setattr("fourd.progress.monotonic", lambda: now[0])
    return now


def told(count: int, seconds: float, passed: list[float]) -> list[str]:
    """Lines in a file of a phase whose items take so long each."""
    text = io.StringIO()
    for _ in Tracker(Console(file=text, width=40)).track(range(count), count, "mattes"):
        passed[0] += seconds
    return text.getvalue().splitlines()


def test_a_file_gets_lines_with_the_time_left(passed: list[float]) -> None:
    """Catches hours of silence in a log, a line for every item, and times left that do not come true."""
    lines = told(100, 1.0, passed)
    assert lines == [
        "mattes: 30 of 100 after 0:00:30, 0:01:10 left",
        "mattes: 60 of 100 after 0:01:00, 0:00:40 left",
        "mattes: 90 of 100 after 0:01:30, 0:00:10 left",
        "mattes: 100 of 100 after 0:01:40",
    ]


def test_a_short_phase_is_not_worth_a_line(passed: list[float]) -> None:
    """Catches logs that are full of phases of no length, and a division by none done."""
    assert told(10, 0.1, passed) == []
    assert told(0, 1.0, passed) == []
    assert told(1, 5.0, passed) == ["mattes: 1 of 1 after 0:00:05"]


def test_two_that_end_together_do_not_halve_the_time_left() -> None:
    """Catches a rate that is taken between two results of processes which keep step, far too short or too long."""
    pace = Pace(0.0, 100)
    assert [pace.end_after(20.0, 1), pace.end_after(20.0, 2)] == [2000.0, 1000.0]
    ends = [pace.end_after(20.0 * turn, 2 * turn - 1 + second) for turn in range(2, 40) for second in (0, 1)]
    assert max(abs(end - 1000) for end in ends[1::2]) < 1e-6
    assert max(abs(end - 1000) for end in ends[20::2]) < 60


def test_the_time_left_follows_a_machine_that_becomes_slower() -> None:
    """Catches a mean of hours that says minutes while the work has slowed to a tenth."""
    pace = Pace(0.0, 20_000)
    for done in range(1, 10_001):
        pace.end_after(0.1 * done, done)
    slow = [pace.end_after(1000.0 + number, 10_000 + number) for number in range(1, 121)]
    assert slow[-1] == pytest.approx(1000 + 10_000)


def test_a_terminal_shows_count_and_time_left() -> None:
    """Catches a bar that stands still, has no time left, or stays on the screen."""
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


def test_a_clock_counts_hours_and_not_below_nothing() -> None:
    """Catches a bar that is late and shows a negative time."""
    assert clock(3 * 3600 + 62) == "3:01:02"
    assert clock(-4.0) == "0:00:00"
