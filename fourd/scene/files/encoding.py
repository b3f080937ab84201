"""Quantisation parameters of the points of a packed scene (a `.4dv` with quantised and compressed points)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from fourd.rendering.ops.morton import MAX_BITS
from fourd.rendering.ops.shade.harmonics import SH_TERMS

Tier = Literal["full", "stream", "video", "light"]
"""Quality of a packed scene. "full" looks like the unpacked scene. "stream" has coarser quantisation steps. "video"
is like "stream", except that it does not store a colour for each point and source view: for each source view, it stores
one image, from which the points' colours in this view are computed. "light" has no source views and stores all colours
as spherical harmonics."""
TIERS: tuple[Tier, ...] = ("full", "stream", "video", "light")

SH_NUMBERS = 3 * SH_TERMS
MAX_COLOUR_STEP = 127
MAX_CODE = 255
"""Maximum code of a density or of a blend weight."""
MIN_IMAGE_SCALE = 1 / 64
Steps = Annotated[int, Meta(ge=1, le=1 << 16)]
"""Number of codes for each doubling of a radius, or for each halving of a weight."""


@dataclass(frozen=True, eq=False)
class CloudEncoding:
    """Quantisation parameters of one cloud of points. The dynamic points of all frames share one encoding; the
    background has a separate one.

    Attributes:
        lower: (3,) float64, smallest coordinates in world units.
        position_step: quantisation step of the coordinates, in world units.
        position_bits: number of bits per coordinate, 1 to 21.
        radius_lower: radius of code 1, in world units. Code 0 is the radius 0.
        radius_steps: number of codes for each doubling of the radius.
        density_levels: code of the density 1, at most 255. Code c is the density c / ``density_levels``.
        sh_basis: (K, 48) float32, orthonormal basis vectors as rows, each with 16 coefficients for red, then 16 for
            green, then 16 for blue. The spherical-harmonics coefficients of a point are ``sh_mean`` plus a weighted sum
            of the basis vectors. Each point stores K weights, which are called factors.
        sh_mean: (48,) float32, mean of the coefficients.
        sh_step: quantisation step of the factors.
        weight_steps: number of codes for each halving of the blend weight. Code 1 is the point's largest blend weight,
            larger codes are smaller weights, and code 0 is the weight 0.
        colour_step: quantisation step of the colours in the source views, in units of 1/255, at most MAX_COLOUR_STEP.
        every_point_has_colours: whether a point's colours are stored for all source views. If false, they are stored
            only for the views in which its blend weight is above 0; in the other views, the point has its mean colour.
        image_scale: texels per pixel of the source cameras, if the colours in the source views are stored as images
            (:mod:`fourd.scene.packed.images`). None if they are stored for each point.
    """

    lower: NDArray[np.float64]
    position_step: Annotated[float, Meta(ge=1e-30, lt=1e30)]
    position_bits: Annotated[int, Meta(ge=1, le=MAX_BITS)]
    radius_lower: Annotated[float, Meta(ge=1e-30, le=1e4)]
    radius_steps: Steps
    density_levels: Annotated[int, Meta(ge=1, le=MAX_CODE)]
    sh_basis: NDArray[np.float32]
    sh_mean: NDArray[np.float32]
    sh_step: Annotated[float, Meta(ge=1e-9, le=1e3)]
    weight_steps: Steps
    colour_step: Annotated[int, Meta(ge=1, le=MAX_COLOUR_STEP)]
    every_point_has_colours: bool
    image_scale: Annotated[float, Meta(ge=MIN_IMAGE_SCALE, le=1)] | None = None

    def __post_init__(self) -> None:
        for name, count in (("lower", 3), ("sh_mean", SH_NUMBERS)):
            if (found := getattr(self, name).shape) != (count,):
                raise ValueError(f"{name}: expected {count} finite numbers, got an array of shape {found}")
        if (size := self.sh_basis.size) % SH_NUMBERS or size > SH_NUMBERS**2:
            raise ValueError(
                f"sh_basis: expected at most {SH_NUMBERS} rows of {SH_NUMBERS} numbers, got {size} numbers"
            )
        # In a manifest, the rows are one list.
        object.__setattr__(self, "sh_basis", self.sh_basis.reshape(-1, SH_NUMBERS))

    @property
    def code_bytes(self) -> int:
        """Number of bytes of the Morton code of a point's position."""
        return (3 * self.position_bits + 7) // 8


@dataclass(frozen=True, eq=False)
class SceneEncoding:
    """The tier of a packed scene (its quality, such as "full" or "light"), and the encodings of its dynamic points and
    of its background."""

    tier: Tier
    dynamic: CloudEncoding
    background: CloudEncoding | None = None
