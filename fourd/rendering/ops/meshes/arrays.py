"""Triangle rasterization for NumPy arrays with the CPU kernels, without torch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.loading import load_native, simd_name, thread_count


def draw_attributes(
    positions: NDArray[np.float32],
    triangles: NDArray[np.int32],
    attributes: NDArray[np.float32],
    size: tuple[int, int],
    threads: int = 0,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Draw triangles: at each pixel centre, interpolate the visible triangle's vertex attributes perspective-correctly.

    Args:
        positions: (V, 4) clip coordinates.
        triangles: (T, 3) vertex indices. The caller must check that all indices are from 0 to V - 1.
        attributes: (V, C).
        size: (height, width) of the image in pixels, each 1 to 32768.
        threads: number of threads; 0 means the value of the environment variable FOURD_THREADS, or all cores if unset.

    Returns:
        the values (H, W, C), and a mask (H, W) of the pixels that show a triangle. The values of other pixels are 0.

    Raises:
        ImportError: if the native module is not built.
        ValueError, TypeError: for an array of the wrong shape or dtype.
    """
    native, count, simd = load_native(), thread_count(threads), simd_name()
    triangles = np.ascontiguousarray(triangles)
    rast = np.empty((1, *size, 4), np.float32)
    native.rasterize_triangles(np.ascontiguousarray(positions)[None], triangles, None, None, count, simd, rast, None)
    values = np.empty((1, *size, attributes.shape[1]), np.float32)
    derivatives = np.empty((1, *size, 0), np.float32)
    channels = np.empty(0, np.int32)
    native.interpolate_attributes(
        np.ascontiguousarray(attributes)[None], rast, triangles, None, channels, count, simd, values, derivatives
    )
    return values[0], rast[0, ..., 3] > 0
