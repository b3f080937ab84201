"""Formats the values that ``fourd info`` prints."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

NAMES_SHOWN = 24
"""Maximum number of names in a list."""


def bytes_text(count: float) -> str:
    """Return a number of bytes with a unit."""
    for unit in ("B", "KB", "MB", "GB"):
        if count < 1000:
            return f"{count:.3g} {unit}" if count < 100 else f"{count:.0f} {unit}"
        count /= 1000
    return f"{count:.3g} TB"


def count_text(count: int, noun: str) -> str:
    """Return a number of things, such as "1 image" or "2 images"."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def span_text(counts: tuple[int, ...]) -> str:
    """Return the smallest and the largest of some counts."""
    if not counts:
        return "0"
    low, high = min(counts), max(counts)
    return f"{low:,}" if low == high else f"{low:,} to {high:,}"


def numbers_text(numbers: tuple[int, ...]) -> str:
    """Return the first and the last frame number."""
    return f"numbers {numbers[0]} to {numbers[-1]}" if numbers else "none"


def names_text(names: Iterable[str]) -> str:
    """Return names, of which at most NAMES_SHOWN are shown."""
    listed = list(names)
    more = len(listed) - NAMES_SHOWN
    return ", ".join(islice(listed, NAMES_SHOWN)) + (f" and {more} more" if more > 0 else "")


def sizes_text(sizes: Iterable[tuple[int, int]]) -> str:
    """Return image sizes, with the number of images of each."""
    counts: dict[tuple[int, int], int] = {}
    for size in sizes:
        counts[size] = counts.get(size, 0) + 1
    parts = [
        f"{width} x {height}" + (f" ({count})" if len(counts) > 1 else "") for (width, height), count in counts.items()
    ]
    return ", ".join(parts[:4]) + (f" and {len(parts) - 4} more sizes" if len(parts) > 4 else "")


def vector_text(values: Iterable[float]) -> str:
    """Return a vector with three digits per component."""
    return "(" + ", ".join(f"{float(value):.3g}" for value in values) + ")"


def unit_text(metres_per_unit: float | None) -> str:
    """Return the length of a world unit."""
    return "not known" if metres_per_unit is None else f"{metres_per_unit:g} m"
