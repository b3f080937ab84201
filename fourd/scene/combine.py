"""Combination of a frame's dynamic points with the background points of a full scene (a scene with a static
background). The colours of the background points are multiplied by the frame's shadow factors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.scene.scene import SHADOW_IDENTITY, BakedFrame, make_frame

_ROWS = 2048
"""Number of points whose colours are multiplied by the shadow in one block, chosen such that the block fits in the L2
cache."""


def combine_frames(dynamic: BakedFrame, background: BakedFrame, shadow: NDArray[np.uint8] | None = None) -> BakedFrame:
    """Concatenate dynamic and background points, in this order, into one frame with new read-only arrays.

    The combined frame keeps a reference to ``background``, so that a renderer recognises a background that it has
    already uploaded.

    Args:
        dynamic: the N dynamic points of the frame.
        background: the M background points. The background must have the same source views and attributes as
            ``dynamic``.
        shadow: (M,) uint8 factors, in units of 1/128, that multiply the background's colours. If ``shadow`` is None,
            the colours are unchanged.

    Raises:
        ValueError: for an invalid argument. The message names the argument and the expected value.
    """
    if background.view_count != dynamic.view_count:
        raise ValueError(f"background: expected {dynamic.view_count} source views, got {background.view_count}")
    if background.attributes != dynamic.attributes:
        expected, got = ([item.name for item in frame.attributes] for frame in (dynamic, background))
        raise ValueError(f"background: expected the attributes {expected}, got {got}")
    if shadow is not None and (shadow.dtype != np.uint8 or shadow.shape != (background.point_count,)):
        raise ValueError(
            f"shadow: expected uint8 of shape ({background.point_count},), got {shadow.dtype} of shape {shadow.shape}"
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
    """Multiply colours (M, V, 3) by factors (M,) in place. Results are rounded half up and clipped at 255.

    Points with factor 1 are skipped, because most factors are 1.
    """
    points, views, channels = rgb.shape
    rows = rgb.reshape(points, views * channels)
    changed = np.flatnonzero(shadow != SHADOW_IDENTITY)
    factors = shadow[changed, None].astype(np.uint16)
    for start in range(0, len(changed), _ROWS):
        chunk = changed[start : start + _ROWS]
        products = rows[chunk] * factors[start : start + _ROWS]
        products += SHADOW_IDENTITY // 2  # The sum is at most 255 * 255 + 64, which fits in 16 bits.
        products //= SHADOW_IDENTITY
        rows[chunk] = np.minimum(products, 255, out=products)
