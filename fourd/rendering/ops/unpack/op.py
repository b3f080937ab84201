"""Decoding of packed scenes with the CPU kernel. :mod:`fourd.scene.packed.members` describes the data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.loading import load_native, simd_name

SH_NUMBERS = 48


def unpack_positions(
    content: NDArray[np.uint8], lower: NDArray[np.float64], step: float, points: int
) -> NDArray[np.float32]:
    """Decode the positions (N, 3) from Morton codes.

    Args:
        content: (B * N,) differences between successive codes, each an integer of B bytes. They are stored as B planes
            of N bytes, with the lowest bytes first. The codes are the cumulative sums of the differences modulo 2^64.
        lower: (3,) position of the Morton code 0.
        step: distance between adjacent positions along an axis.
        points: N.

    Raises:
        ImportError: if the native module is not built.
        ValueError: if the sizes do not match.
    """
    out = np.empty((points, 3), np.float32)
    load_native().unpack_positions(content, np.ascontiguousarray(lower, np.float64), step, out)
    return out


def unpack_harmonics(
    content: NDArray[np.uint8],
    basis: NDArray[np.float32],
    mean: NDArray[np.float32],
    points: int,
    out: NDArray[np.float16] | None = None,
) -> NDArray[np.float16]:
    """Decode spherical harmonics coefficients (N, 48): ``mean + factors @ basis``, rounded to float16, with the factors
    (N, K) from ``content``.

    Args:
        content: (2 * K * N,) zigzag-coded factors, which are the weights of the basis vectors, as low bytes (K, N)
            followed by high bytes (K, N).
        basis: (K, 48) basis vectors, already multiplied by the quantization step of the factors.
        mean: (48,) mean coefficients.
        points: N.
        out: array (N, 48) to write to. If None, a new array is allocated.

    Raises:
        ImportError: if the native module is not built.
        ValueError: if the sizes do not match.
    """
    out = np.empty((points, SH_NUMBERS), np.float16) if out is None else out
    load_native().unpack_harmonics(content, basis, mean, simd_name(), out.view(np.uint16))
    return out


def unpack_views(
    contents: Sequence[NDArray[np.uint8]],
    mean: NDArray[np.uint8],
    weights: NDArray[np.float16],
    colour_step: int,
    *,
    every_point_has_colours: bool,
    out: tuple[NDArray[np.float16], NDArray[np.uint8]] | None = None,
) -> tuple[NDArray[np.float16], NDArray[np.uint8]]:
    """Decode the blend weights (N, V) and the colours (N, V, 3) for V source views.

    Args:
        contents: for each view, N weight codes, then the colour levels of M points: those whose weight code is not 0,
            or all points if ``every_point_has_colours`` is True. A level is the quantised difference from the mean
            colour. The levels are stored as three planes: green, red - green and blue - green, modulo 256.
        mean: (N, 3) mean colours. A level, once decoded from the planes, is a signed 8-bit number from -128 to 127. A
            colour is the mean colour plus ``colour_step`` times the level. If ``colour_step`` is 1, the sum is taken
            modulo 256. If ``colour_step`` is larger, the sum is clamped to [0, 255]. Points without levels have the
            mean colour.
        weights: (256,) blend weight of each code.
        colour_step: quantization step of the signed levels, from 1 to 127.
        every_point_has_colours: True if all points have colours, so that M = N.
        out: arrays (N, V) and (N, V, 3) to write to. If None, new arrays are allocated.

    Raises:
        ImportError: if the native module is not built.
        ValueError: if the sizes do not match.
    """
    points, views = len(mean), len(contents)
    out_weights, out_rgb = out or (np.empty((points, views), np.float16), np.empty((points, views, 3), np.uint8))
    load_native().unpack_views(
        list(contents),
        mean,
        weights.view(np.uint16),
        colour_step,
        every_point_has_colours,
        simd_name(),
        out_weights.view(np.uint16),
        out_rgb,
    )
    return out_weights, out_rgb
