"""Reports the progress of stages: as a bar if the output is a terminal, otherwise as a line of text every 30
seconds."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from time import monotonic
from typing import Protocol, TypeVar

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
from rich.segment import Segment
from rich.text import Text

from fourd.base.limits import printable

Item = TypeVar("Item")
Log = Callable[[str], None]
"""Logging callback that takes one line of text."""

LINE_SECONDS = 30.0
"""Interval in seconds between progress lines if the output is not a terminal."""
RATE_SECONDS = 60.0
"""Minimum length, in seconds, of the time window over which the rate of finished items is measured."""
RATE_ITEMS = 20
"""Minimum number of items in the time window over which the rate of finished items is measured."""
MIN_LOGGED_SECONDS = 2.0
"""If the output is not a terminal, a line of text reports the end of work that took at least this number of seconds."""


class Track(Protocol):
    """A function that wraps an iterable to report progress."""

    def __call__(self, items: Iterable[Item], count: int, what: str) -> Iterable[Item]:
        """Yield ``items`` unchanged. ``count`` is the number of items, and ``what`` names the work in the reports."""


def untracked(items: Iterable[Item], count: int, what: str) -> Iterable[Item]:
    """Return ``items`` unchanged, without progress reports."""
    return items


class Terminal(Console):
    """A console that prints text literally: markup is not interpreted, and control characters are escaped.

    This matters because paths, camera names and messages of libraries can contain square brackets and sequences that
    change the terminal's state.
    """

    def __init__(self, *, stderr: bool = False, quiet: bool = False) -> None:
        super().__init__(stderr=stderr, quiet=quiet, markup=False, emoji=False)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            if segment.control is None and not segment.text.isprintable():
                text = "\n".join(printable(line) for line in segment.text.split("\n"))
                segment = Segment(text, segment.style)
            yield segment


def console_log(console: Console) -> Log:
    """Return a logging callback that prints each line unchanged."""

    def log(line: str) -> None:
        console.print(line, soft_wrap=True, markup=False)

    return log


@dataclass(frozen=True)
class Tracker:
    """Reports progress and the estimated remaining time: as a bar if the console is a terminal, otherwise as lines."""

    console: Console

    def track(self, items: Iterable[Item], count: int, what: str) -> Iterator[Item]:
        """Yield the items and report progress after each item."""
        return self._bar(items, count, what) if self.console.is_terminal else self._lines(items, count, what)

    def _bar(self, items: Iterable[Item], count: int, what: str) -> Iterator[Item]:
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            _RemainingTime(),
        )
        # In notebooks, a bar is a widget, which an empty output would show even if nothing is printed.
        with Progress(*columns, console=self.console, transient=True, disable=self.console.quiet) as progress:
            estimate = EndEstimate(monotonic(), count)
            task = progress.add_task(what, total=count, end=None)
            for done, item in enumerate(items, 1):
                yield item
                progress.update(task, completed=done, end=estimate.update(monotonic(), done))

    def _lines(self, items: Iterable[Item], count: int, what: str) -> Iterator[Item]:
        start = last_line = monotonic()
        estimate = EndEstimate(start, count)
        done = 0
        for done, item in enumerate(items, 1):
            yield item
            now = monotonic()
            end = estimate.update(now, done)
            if now - last_line >= LINE_SECONDS and done < count:
                elapsed, remaining = format_duration(now - start), format_duration(end - now)
                self._print(f"{what}: {done} of {count} after {elapsed}, {remaining} left")
                last_line = now
        if monotonic() - start >= MIN_LOGGED_SECONDS:
            self._print(f"{what}: {done} of {count} after {format_duration(monotonic() - start)}")

    def _print(self, line: str) -> None:
        self.console.print(line, soft_wrap=True, markup=False, highlight=False)


class EndEstimate:
    """Estimates the end of a phase from the rate at which the last items were finished.

    The rate is measured over the last minute, or over the last 20 items if they took longer. This time window is long
    enough for a stable estimate, even if several processes finish items at the same time, and short enough that the
    estimate follows changes of the machine's load.
    """

    def __init__(self, start: float, count: int) -> None:
        """Start a phase of ``count`` items. ``start`` is the current time in seconds, on any clock."""
        self._count = count
        self._marks = deque([(start, 0)])

    def update(self, now: float, done: int) -> float:
        """Return the estimated time of the phase's end, on the same clock as ``now``.

        ``done``, the number of finished items, must increase with every call.
        """
        self._marks.append((now, done))
        while len(self._marks) > RATE_ITEMS + 1 and self._marks[1][0] <= now - RATE_SECONDS:
            self._marks.popleft()
        since, before = self._marks[0]
        return now + (now - since) * (self._count - done) / (done - before)


def format_duration(seconds: float) -> str:
    """Format a duration as H:MM:SS, rounded to seconds. A negative duration is shown as 0."""
    minutes, rest = divmod(round(max(0.0, seconds)), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"


def format_minutes(seconds: float) -> str:
    """Format a duration as M:SS, or as H:MM:SS from one hour on."""
    text = format_duration(seconds)
    return text.removeprefix("0:").removeprefix("0") if text.startswith("0:0") else text.removeprefix("0:")


class _RemainingTime(ProgressColumn):
    """Column of the progress bar that shows the time until the estimated end of the phase."""

    def render(self, task: Task) -> Text:
        end: float | None = task.fields["end"]
        text = "-:--:--" if end is None else format_duration(end - monotonic())
        return Text(text, style="progress.remaining")
