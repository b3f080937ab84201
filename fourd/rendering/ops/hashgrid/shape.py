"""Sizes of a hash grid, and argument checks."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch
    from torch import Tensor

MAX_LEVELS = 32
MAX_FEATURES = 8
LOG2_ENTRIES_RANGE = (4, 24)
ROW_ALIGNMENT = 16
"""The index of every level's first table row is a multiple of this number, so that levels start at a cache line."""
MAX_RESOLUTION = 2**20
"""Maximum number of cells per side, at which float32 still resolves at least 16 positions within a cell."""


@dataclass(frozen=True)
class HashGridShape:
    """Sizes of a hash grid. In the descriptions of the fields, the symbols in parentheses are those of Mueller et al.
    2022.

    Raises:
        ValueError: for an invalid field, with a message that names the field and the expected value.
    """

    levels: int = 16
    """Number of levels (L), 1 to 32. Levels are grids of different resolutions."""
    features: int = 2
    """Number of features per sample (F), 1 to 8."""
    log2_entries: int = 19
    """Base-2 logarithm of the maximum number of stored entries per level (log2 T), 4 to 24. Levels with more samples
    are hashed."""
    coarsest: int = 16
    """Number of cells per side of the first, coarsest level (N_min)."""
    finest: int = 2048
    """Number of cells per side of the last, finest level (N_max), at most 2^20."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("levels", 1, MAX_LEVELS),
            ("features", 1, MAX_FEATURES),
            ("log2_entries", *LOG2_ENTRIES_RANGE),
            ("coarsest", 1, MAX_RESOLUTION),
            ("finest", self.coarsest, MAX_RESOLUTION),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name}: expected {low} to {high}, got {value}")

    @property
    def resolutions(self) -> tuple[int, ...]:
        """Number of cells per side of every level: a geometric progression from ``coarsest`` to ``finest``.

        If the grid has only one level, this level has ``coarsest`` cells per side.
        """
        growth = math.log(self.finest / self.coarsest) / max(self.levels - 1, 1)
        # The term 1e-6 prevents rounding errors from making the last level one cell smaller than ``finest``.
        return tuple(int(self.coarsest * math.exp(growth * level) + 1e-6) for level in range(self.levels))

    @property
    def entries(self) -> tuple[int, ...]:
        """Number of stored entries of every level: its number of samples, which are the corners of its cells, but at
        most 2^log2_entries."""
        return tuple(min((side + 1) ** 3, 2**self.log2_entries) for side in self.resolutions)

    @property
    def offsets(self) -> tuple[int, ...]:
        """Index of the first table row of every level, a multiple of 16."""
        ends = accumulate(self.entries, lambda end, entries: _align(end) + entries)
        return tuple(end - entries for end, entries in zip(ends, self.entries, strict=True))

    @property
    def total_entries(self) -> int:
        """Number of rows of the table: the number of entries of all levels, plus unused padding between levels."""
        return self.offsets[-1] + self.entries[-1]

    @property
    def out_features(self) -> int:
        """Number of features of an encoded point."""
        return self.levels * self.features


def check_hash_grid(coordinates: Tensor, table: Tensor, shape: HashGridShape) -> None:
    """Check the shapes, dtypes and devices of the arguments.

    Raises:
        TypeError, ValueError: for an invalid argument, with a message that names the argument and the expected value.
    """
    import torch  # The shape alone is part of the training config, which commands read for their help.

    if coordinates.ndim != 2 or coordinates.shape[1] != 3:
        raise ValueError(f"coordinates: expected shape (N, 3), got {tuple(coordinates.shape)}")
    expected = (shape.total_entries, shape.features)
    if table.shape != expected:
        raise ValueError(f"table: expected shape {expected}, got {tuple(table.shape)}")
    if coordinates.dtype not in (torch.float32, torch.float64):
        raise TypeError(f"coordinates: expected float32 or float64, got {_dtype_name(coordinates.dtype)}")
    if table.dtype != coordinates.dtype:
        names = [_dtype_name(tensor.dtype) for tensor in (coordinates, table)]
        raise TypeError(f"table: expected {names[0]} like coordinates, got {names[1]}")
    if table.device != coordinates.device:
        raise ValueError(f"table: expected device {coordinates.device} like coordinates, got {table.device}")


def _align(row: int) -> int:
    return (row + ROW_ALIGNMENT - 1) // ROW_ALIGNMENT * ROW_ALIGNMENT


def _dtype_name(dtype: torch.dtype) -> str:
    return str(dtype).removeprefix("torch.")
