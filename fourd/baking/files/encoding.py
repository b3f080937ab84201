"""How a packed scene quantises its points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fourd.ops.shade.harmonics import SH_TERMS

Tier = Literal["full", "stream", "light"]
"""How much a packed scene keeps. "full" looks like the unpacked scene. "stream" has coarser steps. "light" has no
source views: all colour is in spherical harmonics."""
TIERS: tuple[Tier, ...] = ("full", "stream", "light")

SH_NUMBERS = 3 * SH_TERMS
MAX_COLOUR_STEP = 127
MAX_CODE = 255
"""Largest code of a density or of a blend weight."""


@dataclass(frozen=True, eq=False)
class CloudEncoding:
    """How the points of one cloud are quantised. All frames share one encoding, and the background has its own.

    Attributes:
        lower: (3,) float64, smallest coordinates in world units.
        position_step: distance between neighbouring positions of an axis, in world units.
        position_bits: number of bits per coordinate, 1 to 21.
        radius_lower: radius of the code 1, in world units. The code 0 is the radius 0.
        radius_steps: number of codes from a radius to twice this radius.
        density_levels: code of the density 1, at most 255.
        sh_basis: (K, 48) float32, orthonormal rows. The coefficients of spherical harmonics of a point are ``sh_mean``
            plus the sum of the rows, each multiplied by a factor. The 48 numbers are 16 terms for red, then for green,
            then for blue.
        sh_mean: (48,) float32.
        sh_step: quantisation step of the factors.
        weight_steps: number of codes from a blend weight to half this weight. The code 1 is the largest weight of the
            point, and the code 0 is the weight 0.
        colour_step: quantisation step of colours in source views, in units of 1/255, at most MAX_COLOUR_STEP.
        every_point_has_colours: whether colours are stored for all source views of a point, or only for the views with
            a blend weight above 0. Without a stored colour, a point has its mean colour.
    """

    lower: NDArray[np.float64]
    position_step: float
    position_bits: int
    radius_lower: float
    radius_steps: int
    density_levels: int
    sh_basis: NDArray[np.float32]
    sh_mean: NDArray[np.float32]
    sh_step: float
    weight_steps: int
    colour_step: int
    every_point_has_colours: bool

    @property
    def code_bytes(self) -> int:
        """Number of bytes of the Morton code of a position."""
        return (3 * self.position_bits + 7) // 8


@dataclass(frozen=True, eq=False)
class SceneEncoding:
    """The tier of a packed scene, and the encodings of its dynamic points and of its background."""

    tier: Tier
    dynamic: CloudEncoding
    background: CloudEncoding | None = None
