"""Sizes of a hash grid, and argument checks."""

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
"""The first row of every level is a multiple of this number, so that levels start at a cache line."""
MAX_RESOLUTION = 2**20
"""Maximum number of cells per side. Up to this size, float32 resolves at least 16 positions within a cell."""


@dataclass(frozen=True)
class HashGridShape:
    """Sizes of a hash grid. The symbols of Mueller et al. 2022 are in brackets.

    Raises:
        ValueError: for an invalid field. The message names the field and the expected value.
    """

    levels: int = 16
    """Number of levels, which are grids of different resolutions, 1 to 32 (L)."""
    features: int = 2
    """Number of features per sample, 1 to 8 (F)."""
    log2_entries: int = 19
    """Log2 of the maximum number of stored entries per level, 4 to 24 (log2 T). Levels with more samples are hashed."""
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
        """Cells per side of every level: a geometric progression from coarsest to finest.

        If there is only one level, it has the coarsest resolution.
        """
        growth = math.log(self.finest / self.coarsest) / max(self.levels - 1, 1)
        # Without 1e-6, rounding could reduce the last level to one cell less than the finest resolution.
        return tuple(int(self.coarsest * math.exp(growth * level) + 1e-6) for level in range(self.levels))

    @property
    def entries(self) -> tuple[int, ...]:
        """Number of stored entries of every level: the number of samples, but at most 2^log2_entries."""
        return tuple(min((side + 1) ** 3, 2**self.log2_entries) for side in self.resolutions)

    @property
    def offsets(self) -> tuple[int, ...]:
        """Index of the first table row of every level, a multiple of 16."""
        ends = accumulate(self.entries, lambda end, entries: _align(end) + entries)
        return tuple(end - entries for end, entries in zip(ends, self.entries, strict=True))

    @property
    def total_entries(self) -> int:
        """Number of rows of the table: the entries of all levels and the unused padding between levels."""
        return self.offsets[-1] + self.entries[-1]

    @property
    def out_features(self) -> int:
        """Number of features of an encoded point."""
        return self.levels * self.features


def check_hash_grid(coordinates: Tensor, table: Tensor, shape: HashGridShape) -> None:
    """Check the shapes, dtypes and devices of the arguments.

    Raises:
        TypeError, ValueError: for an invalid argument. The message names the argument and the expected value.
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
