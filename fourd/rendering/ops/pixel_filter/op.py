"""The pixel filter's CPU kernel, for 8-bit NumPy images.

Points are composited only at pixel centres, so their contours are jagged. The pixel filter smooths the contours by
replacing each pixel with a weighted mean of 3 x 3 pixels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.loading import load_native, simd_name, thread_count
from fourd.rendering.ops.points.validation import check_canvas


def filter_pixels(
    image: NDArray[np.uint8], side: float, *, threads: int = 0, out: NDArray[np.uint8] | None = None
) -> NDArray[np.uint8]:
    """Filter an image with the weights ``(side, 1 - 2 * side, side)`` along rows and along columns.

    Pixels outside the image are copies of the nearest pixel inside. Each byte of the result differs by at most 1 from
    the rounded result of :func:`fourd.rendering.ops.pixel_filter.reference.filter_pixels_reference`.

    Args:
        image: C-contiguous (H, W, 4) uint8 image.
        side: weight of a neighbouring pixel, from 0 to 0.25. If 0, the image is copied.
        threads: number of threads; 0 means the environment variable FOURD_THREADS, or all cores if it is not set.
        out: C-contiguous (H, W, 4) uint8 array that does not overlap ``image``. If None, a new array is allocated.

    Returns:
        (H, W, 4) uint8 image, which is ``out`` itself if given.

    Raises:
        TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
    """
    if out is None:
        out = np.empty(image.shape, np.uint8)
    height, width, channels = image.shape
    check_canvas(out, (height, width, channels), out.flags.c_contiguous)
    load_native().filter_pixels(image, side, thread_count(threads), simd_name(), out)
    return out
