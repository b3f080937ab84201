"""Progress bars that all stages show alike."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

Item = TypeVar("Item")


class Track(Protocol):
    """Wraps a loop for a progress bar."""

    def __call__(self, items: Iterable[Item], count: int, what: str) -> Iterable[Item]:
        """The same items, which are ``count``; ``what`` is done with them."""


def untold(items: Iterable[Item], count: int, what: str) -> Iterable[Item]:
    """The items, without a bar."""
    return items


@dataclass(frozen=True)
class Tracker:
    """Progress bars with the time that is left, on a console that is a terminal."""

    console: Console

    def track(self, items: Iterable[Item], count: int, what: str) -> Iterator[Item]:
        """The items, with a bar that counts them."""
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=self.console, transient=True, disable=not self.console.is_terminal) as progress:
            yield from progress.track(items, total=count, description=what)
