"""The functions of :mod:`fourd.rendering.ops.unpack.op` in NumPy: slow, but simple."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.morton import gather_bits


def unpack_positions_reference(
    content: NDArray[np.uint8], lower: NDArray[np.float64], step: float, points: int
) -> NDArray[np.float32]:
    """Decode the positions (N, 3) from Morton codes."""
    planes = content.reshape(-1, points).astype(np.uint64)
    shifts = (8 * np.arange(len(planes), dtype=np.uint64))[:, None]
    codes = np.cumsum((planes << shifts).sum(axis=0, dtype=np.uint64), dtype=np.uint64)
    cells = np.stack([gather_bits(codes >> np.uint64(axis)) for axis in range(3)], axis=1)
    return (lower + cells * step).astype(np.float32)


def unpack_harmonics_reference(
    content: NDArray[np.uint8], basis: NDArray[np.float32], mean: NDArray[np.float32], points: int
) -> NDArray[np.float16]:
    """Decode spherical harmonics coefficients (N, 48): ``mean + factors @ basis``, rounded to float16, with the factors
    (N, K) from ``content``."""
    low, high = content.reshape(2, len(basis), points).astype(np.int64)
    codes = low + 256 * high
    factors = np.where(codes % 2 == 0, codes // 2, -(codes + 1) // 2)
    return (mean + factors.T.astype(np.float64) @ basis).astype(np.float16)


def unpack_views_reference(
    contents: Sequence[NDArray[np.uint8]],
    mean: NDArray[np.uint8],
    weights: NDArray[np.float16],
    colour_step: int,
    *,
    every_point_has_colours: bool,
) -> tuple[NDArray[np.float16], NDArray[np.uint8]]:
    """Decode the blend weights (N, V) and the colours (N, V, 3) for V source views."""
    points = len(mean)
    out_weights = np.empty((points, len(contents)), np.float16)
    out_rgb = np.empty((points, len(contents), 3), np.uint8)
    for view, content in enumerate(contents):
        codes = content[:points]
        seen = np.full(points, True) if every_point_has_colours else codes > 0
        green, red, blue = content[points:].reshape(3, -1).astype(np.int64)
        levels = np.zeros((points, 3), np.int64)
        levels[seen] = np.stack([red + green, green, blue + green], axis=-1)
        signed = (levels + 128) % 256 - 128
        colours = mean + colour_step * signed
        out_rgb[:, view] = colours % 256 if colour_step == 1 else np.clip(colours, 0, 255)
        out_weights[:, view] = weights[codes]
    return out_weights, out_rgb
