"""Regions of space whose points an edit keeps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


class Region(Protocol):
    """A part of space."""

    def contains(self, xyz: NDArray[np.float32]) -> Mask:
        """Return which of the positions (N, 3), in world units, are in the region, as (N,)."""


@dataclass(frozen=True, eq=False)
class Box:
    """An axis-aligned box, in world units, with its faces."""

    lower: Array
    upper: Array

    def contains(self, xyz: NDArray[np.float32]) -> Mask:
        return np.asarray(((xyz >= self.lower) & (xyz <= self.upper)).all(axis=1))


@dataclass(frozen=True, eq=False)
class Cylinder:
    """An infinite cylinder around the line through ``centre`` along the unit vector ``axis``, in world units."""

    centre: Array
    axis: Array
    radius: float

    def contains(self, xyz: NDArray[np.float32]) -> Mask:
        offset = xyz - self.centre
        along = offset @ self.axis
        across = np.square(offset).sum(axis=1) - np.square(along)
        return np.asarray(across <= self.radius**2)


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """The points whose coordinate along the unit vector ``up`` is at least ``height``, in world units."""

    up: Array
    height: float

    def contains(self, xyz: NDArray[np.float32]) -> Mask:
        return np.asarray(xyz @ self.up >= self.height)
