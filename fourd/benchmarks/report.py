"""Benchmark results as a table and as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass

from rich.table import Table

from fourd.benchmarks.cases import Case
from fourd.benchmarks.machine import Machine
from fourd.benchmarks.timing import Clock, Timing

FORMAT_VERSION = 1


@dataclass(frozen=True)
class Row:
    """The timing of a case, and the timings of its rivals (other implementations) by name."""

    name: str
    timing: Timing
    rivals: dict[str, Timing]

    @classmethod
    def measure(cls, case: Case, clock: Clock, *, rivals: bool) -> Row:
        """Time a case and, if ``rivals`` is true, its rivals."""
        others = {name: clock.time(work, case.repeats) for name, work in case.rivals.items()} if rivals else {}
        return cls(case.name, clock.time(case.work, case.repeats), others)


def table(rows: Iterable[Row]) -> Table:
    """Format the rows as a table for the terminal."""
    shown = Table(box=None, pad_edge=False)
    shown.add_column("work", max_width=70)
    for title in ("ms", "units", "against"):
        shown.add_column(title, justify="right" if title != "against" else "left")
    for row in rows:
        shown.add_row(row.name, f"{row.timing.ms:.1f}", f"{row.timing.units:.3f}", _format_rivals(row))
    return shown


def markdown(rows: Iterable[Row], machine: Machine) -> str:
    """Format the rows as a Markdown table."""
    lines = [str(machine), "", "| work | ms | units | against |", "|---|---|---|---|"]
    lines += [f"| {row.name} | {row.timing.ms:.1f} | {row.timing.units:.3f} | {_format_rivals(row)} |" for row in rows]
    return "\n".join(lines) + "\n"


def to_json(rows: Iterable[Row], machine: Machine) -> str:
    """Format the rows as JSON: for every case and rival, the time in milliseconds, the time as a multiple of the time
    of a fixed computation (see :class:`Timing`), and the number of runs."""
    content = {"format": "fourd-bench", "version": FORMAT_VERSION, "machine": asdict(machine)}
    return json.dumps({**content, "rows": [asdict(row) for row in rows]}, indent=1) + "\n"


def _format_rivals(row: Row) -> str:
    return "; ".join(
        f"{name} {rival.ms:,.0f} ms ({rival.units / row.timing.units:,.1f} times as long)"
        for name, rival in row.rivals.items()
    )
