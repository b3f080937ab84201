"""Markdown tables, in which the programs in this folder print what they have measured."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def head(titles: Sequence[str]) -> str:
    """Return the first two lines of a table: the titles of its columns, and the line below them."""
    return f"{row(titles)}\n|{'---|' * len(titles)}"


def row(cells: Iterable[object]) -> str:
    """Return a row of a table."""
    return f"| {' | '.join(map(str, cells))} |"


def table(titles: Sequence[str], rows: Iterable[Iterable[object]]) -> str:
    """Return a table with one line per row, without a line break at its end."""
    return "\n".join([head(titles), *map(row, rows)])
