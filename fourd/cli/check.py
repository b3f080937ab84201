"""Tell what a capture holds and all that is wrong with it, in one screen."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table
from rich.text import Text

from fourd.capture.check import Report, check_capture, shown
from fourd.errors import UserError

MOST_LINES = 20


@dataclass(frozen=True)
class Arguments:
    """Exit code 0 when fourd can use the capture, 2 when it cannot."""

    capture: tyro.conf.Positional[Path]
    """The capture's folder."""
    deep: bool = False
    """Decode every picture, which finds damaged ones."""


def run(arguments: Arguments) -> None:
    """Check and print; raises UserError, which tells the first problem, when there are any."""
    console = Console()
    report = check_capture(arguments.capture, deep=arguments.deep, track=_tracked)
    console.print(_facts(arguments.capture, report))
    for title, style, lines in (("problem", "bold red", report.problems), ("warning", "yellow", report.warnings)):
        for line in shown(lines, MOST_LINES):
            console.print(Text(f"{title}: ", style).append(line, "default"), soft_wrap=True)
    if report.problems:
        more = len(report.problems) - 1
        raise UserError(report.problems[0] + (f" (and {more} more, listed above)" if more else ""))
    next_command = f"next: fourd make {arguments.capture} -o scene.4dv"
    console.print(Text("Good to use", "green"), next_command, sep="; ", soft_wrap=True)


def _tracked(files: Sequence[Path]) -> Iterable[Path]:
    console = Console(stderr=True)
    return track(files, description="check", console=console, transient=True, disable=not console.is_terminal)


def _facts(path: Path, report: Report) -> Table:
    sizes = Counter(f"{width} x {height}" for width, height in report.sizes.values())
    table = Table(title=Text(str(path)), title_justify="left", show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    table.add_row("cameras", f"{len(report.cameras)}: {', '.join(report.cameras)}")
    table.add_row("frames", str(report.frames))
    table.add_row("pictures", ", ".join(f"{size} ({count})" for size, count in sizes.items()) or "none")
    table.add_row("distortion", f"in {report.distorted} cameras" if report.distorted else "none")
    table.add_row("distance", f"{report.ring_radius:.3g} world units from the cameras to where they look")
    coverage = "" if report.coverage is None else f"; they hold {report.coverage:.1%} of the pictures"
    table.add_row("mattes", ("yes" if report.has_masks else "none") + coverage)
    table.add_row("size", f"{report.nbytes / 1e6:.1f} MB")
    return table
