"""The table of the arrays that a baked frame consists of. It is used by the manifest, the scene reader and writer, the
combination of frames and the upload to OpenGL.

A new attribute needs three changes: a row with ``is_optional=True`` in :data:`ATTRIBUTES`, a field of the same name in
:class:`fourd.scene.scene.BakedFrame`, and code in :mod:`fourd.scene.bake` that computes it. Scenes without the new
attribute stay readable, and older programs skip it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.shade.harmonics import SH_TERMS

Values = Literal["any", "finite", "nonnegative", "unit"]
"""Valid values of an attribute. "unit" means [0, 1]. Only "any" permits NaN and infinity."""

Combine = Literal["concatenate", "cast_shadow"]
"""How the array of the scene's static background points is appended to the array of a frame's dynamic points.
"concatenate" appends it unchanged; "cast_shadow" first multiplies it by the frame's shadow factors."""


@dataclass(frozen=True)
class Attribute:
    """One array of a frame, as stored in the file.

    Attributes:
        name: name of the array. Its field in BakedFrame, its file inside the ZIP and its key in the manifest have this
            name.
        dtype: little-endian NumPy dtype.
        shape: size of each dimension of the array. "points" stands for the number of points and "views" for the number
            of source views.
        values: the valid values, see :data:`Values`.
        combine: how the array of the static background points is appended to that of the dynamic points, see
            :data:`Combine`.
        is_optional: whether a scene may lack this attribute.
    """

    name: str
    dtype: str
    shape: tuple[str | int, ...]
    values: Values = "finite"
    combine: Combine = "concatenate"
    is_optional: bool = False

    @property
    def is_per_view(self) -> bool:
        """Whether the array has separate values for every source view."""
        return "views" in self.shape

    @property
    def numbers(self) -> int:
        """Number of values that the array stores per point, or per point and source view if :attr:`is_per_view` is
        true."""
        count = 1
        for side in self.shape:
            count *= side if isinstance(side, int) else 1
        return count

    def resolve_shape(self, points: int, views: int) -> tuple[int, ...]:
        """Return the array's shape for the given numbers of points and source views."""
        counts = {"points": points, "views": views}
        return tuple(counts[side] if isinstance(side, str) else side for side in self.shape)

    def nbytes(self, points: int, views: int) -> int:
        """Return the size of the array in bytes."""
        count = 1
        for side in self.resolve_shape(points, views):
            count *= side
        return count * np.dtype(self.dtype).itemsize

    def check(self, array: NDArray[Any], points: int, views: int) -> None:
        """Check the array's shape and dtype. Raises a ValueError that names the attribute."""
        shape, dtype = self.resolve_shape(points, views), np.dtype(self.dtype)
        if array.shape != shape or array.dtype != dtype:
            raise ValueError(
                f"{self.name}: expected {dtype} of shape {shape}, got {array.dtype} of shape {array.shape}"
            )

    def has_valid_values(self, array: NDArray[Any]) -> bool:
        """Return True if every element satisfies the constraint ``self.values``."""
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
    Attribute("normals", "|u1", ("points", 2), values="any", is_optional=True),
)
"""All attributes. The files inside a scene's ZIP archive and the native kernels' arguments have the same order."""


def _valid_halves(bits: NDArray[np.uint16], values: Values) -> bool:
    """Return True if all values of a float16 array are in the range that ``values`` names, see :data:`Values`.
    ``bits`` contains the bit patterns of the array.

    Comparing bit patterns is several times faster than comparing floats.
    """
    limit = 0x3C00 if values == "unit" else 0x7BFF
    if values == "finite":
        bits = bits & np.uint16(0x7FFF)
    if int(bits.max()) <= limit:
        return True
    # Bit patterns above ``limit`` belong to values that are too large, to infinity or NaN (from 0x7C00), or to negative
    # values (from 0x8000). Of all these, only -0, with the bit pattern 0x8000, is valid.
    return int(np.where(bits == 0x8000, np.uint16(0), bits).max()) <= limit
