"""Lengths of a scene with their unit, which not every calibration states."""

from __future__ import annotations

MIN_UNIT_M, MAX_UNIT_M = 1e-9, 1e9
"""Smallest and largest length of a world unit in metres that a file may state."""
UNKNOWN_UNIT = "world units"


def format_length(length: float, metres_per_unit: float | None, digits: str = ".3g") -> str:
    """Return a length in world units with its unit: in metres, or in world units if their length is not known.

    Args:
        length: the length in world units.
        metres_per_unit: length of a world unit in metres, or None if it is not known.
        digits: format of the number.
    """
    if metres_per_unit is None:
        return f"{length:{digits}} {UNKNOWN_UNIT}"
    return f"{length * metres_per_unit:{digits}} m"
