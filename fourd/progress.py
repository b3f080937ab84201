"""Progress that all stages show alike: a bar on a terminal, a line now and then in a file."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from time import monotonic
from typing import Protocol, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
from rich.text import Text

Item = TypeVar("Item")
Log = Callable[[str], None]
"""Is told what was found, a line each."""

LINE_SECONDS = 30.0
"""Between two lines where there is no terminal."""
PACE_SECONDS = 60.0
PACE_ITEMS = 20
WORTH_TELLING_SECONDS = 2.0
"""A phase that was shorter gets no line."""


class Track(Protocol):
    """Wraps a loop for a progress bar."""

    def __call__(self, items: Iterable[Item], count: int, what: str) -> Iterable[Item]:
        """The same items, which are ``count``; ``what`` is done with them."""


def untracked(items: Iterable[Item], count: int, what: str) -> Iterable[Item]:
    """The items, without a bar."""
    return items


def console_log(console: Console) -> Log:
    """Prints lines as they are."""

    def told(line: str) -> None:
        console.print(line, soft_wrap=True, markup=False)

    return told


@dataclass(frozen=True)
class Tracker:
    """Progress with the time that is left: bars where the console is a terminal, lines where it is none."""

    console: Console

    def track(self, items: Iterable[Item], count: int, what: str) -> Iterator[Item]:
        """The items, counted as they are done."""
        return self._bar(items, count, what) if self.console.is_terminal else self._lines(items, count, what)

    def _bar(self, items: Iterable[Item], count: int, what: str) -> Iterator[Item]:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            _TimeLeft(),
        )
        with Progress(*columns, console=self.console, transient=True) as progress:
            pace = Pace(monotonic(), count)
            task = progress.add_task(what, total=count, ends=None)
            for done, item in enumerate(items, 1):
                yield item
                progress.update(task, completed=done, ends=pace.end_after(monotonic(), done))

    def _lines(self, items: Iterable[Item], count: int, what: str) -> Iterator[Item]:
        begun = told = monotonic()
        pace = Pace(begun, count)
        done = 0
        for done, item in enumerate(items, 1):
            yield item
            now = monotonic()
            ends = pace.end_after(now, done)
            if now - told >= LINE_SECONDS and done < count:
                self._say(f"{what}: {done} of {count} after {clock(now - begun)}, {clock(ends - now)} left")
                told = now
        if monotonic() - begun >= WORTH_TELLING_SECONDS:
            self._say(f"{what}: {done} of {count} after {clock(monotonic() - begun)}")

    def _say(self, line: str) -> None:
        self.console.print(line, soft_wrap=True, markup=False, highlight=False)


class Pace:
    """When a phase will end, by how fast its last items were done.

    These are all of the last minute, and 20 at least: enough that processes which end their items together do not
    shake it, and few enough that it follows a machine which gets other work.
    """

    def __init__(self, begun: float, count: int) -> None:
        """At ``begun``, seconds on any clock; the phase has ``count`` items."""
        self._count = count
        self._marks = deque([(begun, 0)])

    def end_after(self, now: float, done: int) -> float:
        """When the last item will be done, on the same clock; ``done``, at least 1 more than before, are so ``now``."""
        self._marks.append((now, done))
        while len(self._marks) > PACE_ITEMS + 1 and self._marks[1][0] <= now - PACE_SECONDS:
            self._marks.popleft()
        since, before = self._marks[0]
        return now + (now - since) * (self._count - done) / (done - before)


def clock(seconds: float) -> str:
    """H:MM:SS of whole seconds, as the bars have it."""
    minutes, rest = divmod(round(max(0.0, seconds)), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"


class _TimeLeft(ProgressColumn):
    """Counts down to when the phase is expected to end."""

    def render(self, task: Task) -> Text:
        ends: float | None = task.fields["ends"]
        left = "-:--:--" if ends is None else clock(ends - monotonic())
        return Text(left, style="progress.remaining")
