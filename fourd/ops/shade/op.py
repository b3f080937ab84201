"""Colours of baked points seen from a camera, by the CPU kernel, for NumPy arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.ops.loading import load_native, simd_name, thread_count
from fourd.ops.shade.shading import Shading


def shade_points(
    xyz: NDArray[np.float32],
    sh: NDArray[np.float16],
    blend_weights: NDArray[np.float16],
    rgb: NDArray[np.uint8],
    shading: Shading,
    *,
    threads: int = 0,
) -> NDArray[np.float32]:
    """Blend the colours of the chosen source views and add spherical harmonics (4K4D, sec. 3.2).

    With d the unit vector from the camera to the point, the colour is
    ``sum_v w_v rgb_v / sum_v w_v + sh_base + sh_range * tanh(sh . Y(d))`` over the views v of ``shading``. Where all
    weights are 0, the views count equally.

    Args:
        xyz: (N, 3) positions, world units.
        sh: (N, 3, 16) spherical harmonics of red, green and blue.
        blend_weights: (N, V), not negative.
        rgb: (N, V, 3) the points' colours in the source views.
        shading: the viewpoint and the views to blend, indices below V.
        threads: 0 uses FOURD_THREADS if set, else all cores.

    Returns:
        (N, 3) float32 RGB, not clamped. The result has the same bits for any number of threads.

    Raises:
        ImportError: if the native module is not built.
        ValueError: for shapes that do not match, or a view index that is out of range.
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
