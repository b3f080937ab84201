"""Colours of the vertices of PLY files, whose names, types and ranges differ between programs."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError

NAMES = (
    ("red", "green", "blue"),
    ("diffuse_red", "diffuse_green", "diffuse_blue"),
    ("vertex_red", "vertex_green", "vertex_blue"),
    ("r", "g", "b"),
)
"""Names of the three colour properties, without regard to case. The first set that a file has is used."""
GREY = 128
"""Colour of points whose float colour is NaN."""
_COLOURS = re.compile(r"rgba?|bgra?|colou?rs?|(\w+_)?(red|green|blue)", re.IGNORECASE)
_OVERSHOOT = 2.0
"""Float colours up to this value have the range 0 to 1 and are clipped: as values from 0 to 255, all would be black."""
_DARK = 16.0
"""Float colours above this value have the range 0 to 255."""
_LOWEST = -0.5
"""Least float colour, relative to the upper end of the range, that is clipped to 0."""


def find_colours(path: Path, names: frozenset[str]) -> tuple[str, str, str] | None:
    """Return the names of the properties with red, green and blue, or None if the vertices have no colours.

    Raises:
        UserError: if there are colours under names that are not known, or a channel is missing.
    """
    by_lower = {name.lower(): name for name in sorted(names)}
    for one, two, three in NAMES:
        if {one, two, three} <= by_lower.keys():
            return by_lower[one], by_lower[two], by_lower[three]
    unknown = sorted(name for name in names if _COLOURS.fullmatch(name))
    if unknown:
        raise UserError(
            f"{path}: expected colours as red, green and blue, or none, got the properties {', '.join(unknown)}; "
            "write the file again with uchar red, green and blue"
        )
    return None


def convert_colours(path: Path, values: NDArray[np.float64], types: Mapping[str, str]) -> NDArray[np.uint8]:
    """Convert the colours of all points to 8 bits.

    Unsigned integers have the range of their type. Integers with more than 8 bits whose values are all at most 255 have
    the range 0 to 255, because in the range of their type they would all be black. Float colours have the range 0 to 1
    if none exceeds 2, and 0 to 255 if some exceed 16 or if all are whole numbers and some exceed 1. Float colours that
    are NaN become medium grey.

    Args:
        values: (N, 3).
        types: the names of the three properties and their NumPy types as in the header, such as "u2".

    Raises:
        UserError: if the range of the values is not clear.
    """
    kinds = set(types.values())
    if len(kinds) > 1:
        raise _unclear(path, f"the types {', '.join(sorted(kinds))}", types)
    if values.size == 0:
        return np.zeros(values.shape, np.uint8)
    kind = kinds.pop()
    is_missing = np.isnan(values)
    known = values[~is_missing]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    if kind == "u1":
        limit = 255.0
    elif kind.startswith("f"):
        limit = _float_limit(known, high)
    else:
        limit = _integer_limit(kind, high)
    if not limit or low < (_LOWEST * limit if kind.startswith("f") else 0):
        raise _unclear(
            path, f"{'float' if kind.startswith('f') else 'whole'} numbers from {low:.6g} to {high:.6g}", types
        )
    scaled = np.rint(values.clip(0, limit) * (255.0 / limit))
    return np.where(is_missing, GREY, scaled).astype(np.uint8)


def require_opaque(path: Path, alpha: NDArray[np.float64]) -> None:
    """Raise UserError if points differ in opacity, because the colour alone would show transparent points as opaque."""
    if len(alpha) and not np.ptp(alpha) <= 1e-3 * max(float(np.abs(alpha).max()), 1e-3):
        raise UserError(
            f"{path}: expected opaque points, got alpha from {alpha.min():.6g} to {alpha.max():.6g}; "
            "remove the transparent points and the property alpha"
        )


def _integer_limit(kind: str, high: float) -> float:
    """Return the upper end of the range of integers with more than 8 bits or a sign, or 0 if it is not clear."""
    if high <= 255 and kind != "i1":
        return 255.0
    return 65535.0 if kind in ("u2", "i4", "u4") and high <= 65535 else 0.0


def _float_limit(known: NDArray[np.float64], high: float) -> float:
    """Return the upper end of the range of float colours, or 0 if it is not clear."""
    if not np.isfinite(high):
        return 0.0
    is_whole = high > 1 and bool((known == np.rint(known)).all())
    if high <= _OVERSHOOT and not is_whole:
        return 1.0
    if high <= 255.5:
        return 255.0 if high > _DARK or is_whole else 0.0
    return 65535.0 if high <= 65535.5 else 0.0


def _unclear(path: Path, found: str, types: Mapping[str, str]) -> UserError:
    return UserError(
        f"{path}: expected colours of 8 or 16 bits, or floats from 0 to 1 or from 0 to 255, got {found} in "
        f"{', '.join(types)}; write the file again with uchar red, green and blue"
    )
