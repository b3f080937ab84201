"""The arrays of a baked frame, declared once: the file, the manifest, combining and the GL upload follow this table.

To add an attribute, add a row to :data:`ATTRIBUTES` with ``is_optional=True`` and a field of the same name to
:class:`fourd.baking.scene.BakedFrame`, and compute it in :mod:`fourd.baking.bake`. Older scenes lack it and stay
readable; older programs skip it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fourd.ops.shade.harmonics import SH_TERMS

Values = Literal["any", "finite", "nonnegative", "unit"]
"""Which values are valid; "unit" is [0, 1], and all but "any" exclude NaN and infinity."""

Combine = Literal["concatenate", "cast_shadow"]
"""How a background's array joins a frame's: appended, or appended after multiplication by the frame's shadow."""


@dataclass(frozen=True)
class Attribute:
    """One array of a frame as stored.

    Attributes:
        name: of the field of BakedFrame, the file's member and the manifest's key.
        dtype: little-endian NumPy dtype.
        shape: "points" and "views" stand for their counts.
        values: which values are valid.
        combine: how a full scene's background is joined.
        is_optional: whether scenes may lack it.
    """

    name: str
    dtype: str
    shape: tuple[str | int, ...]
    values: Values = "finite"
    combine: Combine = "concatenate"
    is_optional: bool = False

    @property
    def is_per_view(self) -> bool:
        """Whether every source view has its own values."""
        return "views" in self.shape

    @property
    def numbers(self) -> int:
        """Numbers per point, and per view where the attribute is per view."""
        count = 1
        for side in self.shape:
            count *= side if isinstance(side, int) else 1
        return count

    def resolve_shape(self, points: int, views: int) -> tuple[int, ...]:
        """The shape for given counts."""
        counts = {"points": points, "views": views}
        return tuple(counts[side] if isinstance(side, str) else side for side in self.shape)

    def nbytes(self, points: int, views: int) -> int:
        """Size of the array in bytes."""
        count = 1
        for side in self.resolve_shape(points, views):
            count *= side
        return count * np.dtype(self.dtype).itemsize

    def check(self, array: NDArray[Any], points: int, views: int) -> None:
        """Check shape and dtype. Raises ValueError that names the attribute."""
        shape, dtype = self.resolve_shape(points, views), np.dtype(self.dtype)
        if array.shape != shape or array.dtype != dtype:
            raise ValueError(
                f"{self.name}: expected {dtype} of shape {shape}, got {array.dtype} of shape {array.shape}"
            )

    def has_valid_values(self, array: NDArray[Any]) -> bool:
        """Whether all values are as ``values`` requires."""
        if self.values == "any" or array.size == 0:
            return True
        if array.dtype == np.float16:
            return _valid_halves(array.view(np.uint16), self.values)
        if not np.isfinite(array).all():
            return False
        if self.values == "finite":
            return True
        return bool(array.min() >= 0 and (self.values == "nonnegative" or array.max() <= 1))


ATTRIBUTES = (
    Attribute("xyz", "<f4", ("points", 3)),
    Attribute("radius", "<f2", ("points",), values="nonnegative"),
    Attribute("density", "<f2", ("points",), values="unit"),
    Attribute("sh", "<f2", ("points", 3, SH_TERMS)),
    Attribute("blend_weights", "<f2", ("points", "views"), values="nonnegative"),
    Attribute("rgb", "|u1", ("points", "views", 3), values="any", combine="cast_shadow"),
)
"""In the order of the file's members and of the native kernels' arguments."""


def _valid_halves(bits: NDArray[np.uint16], values: Values) -> bool:
    """Compare float16 as bits, several times faster: the sign makes them large; infinity and NaN start at 0x7C00."""
    limit = 0x3C00 if values == "unit" else 0x7BFF
    if values == "finite":
        bits = bits & np.uint16(0x7FFF)
    if int(bits.max()) <= limit:
        return True
    # -0 is valid.
    return int(np.where(bits == 0x8000, np.uint16(0), bits).max()) <= limit
