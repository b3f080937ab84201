"""Colours of baked points for a viewpoint: the CPU kernel, for NumPy arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.loading import load_native, simd_name, thread_count
from fourd.rendering.ops.shade.shading import Shading


def shade_points(
    xyz: NDArray[np.float32],
    sh: NDArray[np.float16],
    blend_weights: NDArray[np.float16],
    rgb: NDArray[np.uint8],
    shading: Shading,
    *,
    threads: int = 0,
) -> NDArray[np.float32]:
    """Blend the colours of the selected source views and add spherical harmonics (4K4D, sec. 3.2).

    Let d be the unit vector from the camera to the point, and Y(d) the 16 spherical harmonics in direction d. Let w_v
    be the point's blend weight for the view v in ``shading.views``, and f_v the weight of the view. The colour is
    ``sum_v(f_v * w_v * rgb_v) / sum_v(f_v * w_v) + sh_base + sh_range * tanh(sh . Y(d))``. If all blend weights w_v of
    a point are 0, f_v replaces the product f_v * w_v.

    Args:
        xyz: (N, 3) positions, world units.
        sh: (N, 3, 16) spherical harmonics coefficients for red, green and blue.
        blend_weights: (N, V) blend weights, 0 or more.
        rgb: (N, V, 3) uint8 colours of the points in the source views, divided by 255 in the formula above.
        shading: the viewpoint and the indices, from 0 to V - 1, of the views to blend.
        threads: number of threads; 0 means the environment variable FOURD_THREADS, or all cores if it is not set.

    Returns:
        (N, 3) float32 RGB, not clamped. The result is bit-identical for any number of threads.

    Raises:
        ImportError: if the native module is not built.
        ValueError: if shapes do not match or a view index is out of range.
    """
    colours: NDArray[np.float32] = load_native().shade(
        xyz,
        sh.view(np.uint16),
        blend_weights.view(np.uint16),
        rgb,
        *shading.arguments(),
        thread_count(threads),
        simd_name(),
    )
    return colours
