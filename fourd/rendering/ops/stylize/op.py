"""The stylizer's CPU kernel for NumPy arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.loading import load_native, simd_name, thread_count
from fourd.rendering.ops.stylize.parameters import DETAILS, LINE_FILTERS, StyleParameters, Surface


def stylize_surface(
    surface: Surface,
    parameters: StyleParameters,
    *,
    line_state: NDArray[np.uint32] | None = None,
    threads: int = 0,
    out: NDArray[np.uint8] | None = None,
) -> NDArray[np.uint8]:
    """Draw a surface in a style, with the formulas of :mod:`fourd.rendering.ops.stylize.parameters`.

    Args:
        surface: the visible surface, in C-contiguous arrays.
        parameters: the style for the surface's camera.
        line_state: (H, W) uint32 line state of the previous image from the same camera, or None. It is overwritten with
            the state of the new image. Pass zeros for the first image from a camera. The lowest byte of an element is
            the line strength. The upper 16 bits of an element are the upper 16 bits of a float32 number: the sum of the
            inverse depths at the nine taps of the line filter.
        threads: number of threads; 0 means the environment variable FOURD_THREADS, or all cores if it is not set.
        out: C-contiguous (H, W, 4) uint8 array to draw into. If None, a new array is allocated.

    Returns:
        (H, W, 4) uint8 image. RGB is the drawing composited over the paper, which is the colour behind the surface.
        Alpha is the larger of the surface's coverage and the opacity of the drawn line.

    Raises:
        TypeError, ValueError: for an array of the wrong shape or dtype, or a number that is not finite or out of range.
    """
    if out is None:
        out = np.empty((*surface.size, 4), np.uint8)
    load_native().stylize(
        surface.albedo,
        surface.inverse_depth,
        surface.normal,
        parameters.numbers.pack(),
        DETAILS.index(parameters.detail),
        LINE_FILTERS.index(parameters.lines),
        parameters.thickness,
        parameters.pack_table(),
        thread_count(threads),
        simd_name(),
        line_state,
        out,
    )
    return out
