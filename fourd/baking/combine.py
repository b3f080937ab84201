"""A frame of a full scene: its own points, then the background's, in its shadow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.baking.scene import ATTRIBUTES, SHADOW_ONE, BakedFrame

_ROWS = 2048  # a time: what they are multiplied in stays in the second cache


def joined(moving: BakedFrame, background: BakedFrame, shadow: NDArray[np.uint8] | None = None) -> BakedFrame:
    """One frame of the points of both, ``moving``'s first, in new arrays that are read-only.

    It keeps ``background`` as its ``still``, by which renderers know what they have already.

    Args:
        moving: N points.
        background: M points, with as many source views.
        shadow: (M,) factors for the background's colours, in 1/128; None leaves them as they are.

    Raises:
        ValueError: naming the argument, what was expected and what came.
    """
    if background.view_count != moving.view_count:
        raise ValueError(f"background: expected {moving.view_count} source views, got {background.view_count}")
    if shadow is not None and (shadow.dtype != np.uint8 or shadow.shape != (background.point_count,)):
        raise ValueError(
            f"shadow: expected uint8 of shape ({background.point_count},), got {shadow.dtype} of {shadow.shape}"
        )
    arrays = [np.concatenate([getattr(part, item.name) for part in (moving, background)]) for item in ATTRIBUTES]
    frame = BakedFrame(*arrays, still=background, shadowed=shadow is not None)
    if shadow is not None:
        _cast_shadow(frame.rgb[moving.point_count :], shadow)
    for array in arrays:
        array.flags.writeable = False
    return frame


def _cast_shadow(rgb: NDArray[np.uint8], shadow: NDArray[np.uint8]) -> None:
    """Multiply colours (M, V, 3) by factors (M,) in place, rounded half up and cut at 255.

    Most points lie in no shadow: only the others are touched.
    """
    points, views, channels = rgb.shape
    rows = rgb.reshape(points, views * channels)
    changed = np.flatnonzero(shadow != SHADOW_ONE)
    factors = shadow[changed, None].astype(np.uint16)
    for start in range(0, len(changed), _ROWS):
        some = changed[start : start + _ROWS]
        products = rows[some] * factors[start : start + _ROWS]
        products += SHADOW_ONE // 2  # at most 255 * 255 + 64, which 16 bits hold
        products //= SHADOW_ONE
        rows[some] = np.minimum(products, 255, out=products)
