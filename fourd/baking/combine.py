"""Combining a frame's dynamic points with a full scene's background and the shadow on it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.baking.scene import SHADOW_IDENTITY, BakedFrame, make_frame

_ROWS = 2048
"""Rows multiplied at a time, so that they stay in the second-level cache."""


def combine_frames(dynamic: BakedFrame, background: BakedFrame, shadow: NDArray[np.uint8] | None = None) -> BakedFrame:
    """Concatenate the points of both into one frame, the dynamic points first, in new read-only arrays.

    The result keeps ``background``: renderers recognize by it what they have uploaded.

    Args:
        dynamic: N points.
        background: M points, with the same source views and attributes.
        shadow: (M,) factors for the background's colours in units of 1/128; None keeps the colours.

    Raises:
        ValueError: naming the argument, what was expected and what came.
    """
    if background.view_count != dynamic.view_count:
        raise ValueError(f"background: expected {dynamic.view_count} source views, got {background.view_count}")
    if background.attributes != dynamic.attributes:
        expected, got = ([item.name for item in frame.attributes] for frame in (dynamic, background))
        raise ValueError(f"background: expected the attributes {expected}, got {got}")
    if shadow is not None and (shadow.dtype != np.uint8 or shadow.shape != (background.point_count,)):
        raise ValueError(
            f"shadow: expected uint8 of shape ({background.point_count},), got {shadow.dtype} of {shadow.shape}"
        )
    arrays = {}
    for attribute in dynamic.attributes:
        parts = [getattr(frame, attribute.name) for frame in (dynamic, background)]
        array = arrays[attribute.name] = np.concatenate(parts)
        if attribute.combine == "cast_shadow" and shadow is not None:
            _cast_shadow(array[dynamic.point_count :], shadow)
        array.flags.writeable = False
    return make_frame(arrays, background, has_shadow=shadow is not None)


def _cast_shadow(rgb: NDArray[np.uint8], shadow: NDArray[np.uint8]) -> None:
    """Multiply colours (M, V, 3) by factors (M,) in place, rounded half up and clipped at 255.

    Most points lie in no shadow and are not touched.
    """
    points, views, channels = rgb.shape
    rows = rgb.reshape(points, views * channels)
    changed = np.flatnonzero(shadow != SHADOW_IDENTITY)
    factors = shadow[changed, None].astype(np.uint16)
    for start in range(0, len(changed), _ROWS):
        chunk = changed[start : start + _ROWS]
        products = rows[chunk] * factors[start : start + _ROWS]
        products += SHADOW_IDENTITY // 2  # at most 255 * 255 + 64, which fits 16 bits
        products //= SHADOW_IDENTITY
        rows[chunk] = np.minimum(products, 255, out=products)
