"""Sizes of a hash grid, and the checks of its arguments."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate

import torch
from torch import Tensor

MAX_LEVELS = 32
MAX_FEATURES = 8
LOG2_ENTRIES_RANGE = (4, 24)
ROW_ALIGNMENT = 16
"""Rows; every level then begins at a cache line."""
MAX_RESOLUTION = 2**20
"""Cells per side. Float32 still resolves sixteen positions within a cell."""


@dataclass(frozen=True)
class HashGridShape:
    """Sizes of a hash grid; the names in Mueller et al. 2022 are in brackets.

    Raises:
        ValueError: naming the field, what was expected and what came.
    """

    levels: int = 16
    """Number of grids, 1 to 32 (L)."""
    features: int = 2
    """Numbers per sample, 1 to 8 (F)."""
    log2_entries: int = 19
    """Log2 of the maximum number of entries that a level stores, 4 to 24 (T). Larger levels share them by a hash."""
    coarsest: int = 16
    """Cells per side of the first level (N_min)."""
    finest: int = 2048
    """Cells per side of the last level, at most 2^20 (N_max)."""

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
        """Cells per side of every level, in geometric progression. A single level has the coarsest resolution."""
        growth = math.log(self.finest / self.coarsest) / max(self.levels - 1, 1)
        # 1e-6: rounding must not reduce the last level to one cell below the finest resolution.
        return tuple(int(self.coarsest * math.exp(growth * level) + 1e-6) for level in range(self.levels))

    @property
    def entries(self) -> tuple[int, ...]:
        """Stored entries of every level: all samples, or 2^log2_entries if there are more."""
        return tuple(min((side + 1) ** 3, 2**self.log2_entries) for side in self.resolutions)

    @property
    def offsets(self) -> tuple[int, ...]:
        """First table row of every level, a multiple of 16."""
        ends = accumulate(self.entries, lambda end, entries: _align(end) + entries)
        return tuple(end - entries for end, entries in zip(ends, self.entries, strict=True))

    @property
    def total_entries(self) -> int:
        """Rows of the table: those of all levels, and the unused padding between levels."""
        return self.offsets[-1] + self.entries[-1]

    @property
    def out_features(self) -> int:
        """Features of an encoded point."""
        return self.levels * self.features


def check_hash_grid(coordinates: Tensor, table: Tensor, shape: HashGridShape) -> None:
    """Check shapes, dtypes and devices of the arguments of the encoding.

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
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
