"""Colours of baked points for a viewpoint, in NumPy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from fourd.rendering.ops.shade.harmonics import SH_CONSTANT, directional_terms
from fourd.rendering.ops.shade.shading import Shading

CHUNK = 1 << 15


def shade_points_reference(
    xyz: NDArray[np.float32],
    sh: NDArray[np.float16],
    blend_weights: NDArray[np.float16],
    rgb: NDArray[np.uint8],
    shading: Shading,
) -> NDArray[np.float32]:
    """Compute the colours of :func:`fourd.rendering.ops.shade.op.shade_points`."""
    colour = np.empty((len(xyz), 3), dtype=np.float32)
    for start in range(0, len(xyz), CHUNK):
        chunk = slice(start, start + CHUNK)
        offset = xyz[chunk].astype(np.float64) - shading.centre
        length = np.linalg.norm(offset, axis=1, keepdims=True)
        directions = (offset / np.maximum(length, 1e-12)).astype(np.float32)
        harmonics = np.einsum("nck,nk->nc", sh[chunk].astype(np.float32), sh_basis(directions))
        colour[chunk] = shading.sh_base + shading.sh_range * np.tanh(harmonics)
        if len(shading.views):
            weights = _normalize(blend_weights[chunk][:, shading.views].astype(np.float32), shading.view_weights)
            colours = rgb[chunk][:, shading.views].astype(np.float32) / 255
            colour[chunk] += np.einsum("nv,nvc->nc", weights, colours)
    return colour


def sh_basis(directions: NDArray[np.float32]) -> NDArray[np.float32]:
    """Evaluate the 16 real spherical harmonics up to degree 3 at unit vectors (N, 3). Return (N, 16) float32."""
    x, y, z = directions.T
    terms = [np.full_like(x, SH_CONSTANT), *directional_terms(x, y, z)]
    return np.stack(terms, axis=1).astype(np.float32, copy=False)


def _normalize(blend_weights: NDArray[np.float32], view_weights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Multiply blend weights (N, V) by view weights (V,), and normalise each row of the result (N, V) to the sum 1.

    Rows that contain only zeros are replaced by the normalised view weights.
    """
    weights = blend_weights * view_weights
    total = weights.sum(axis=1, keepdims=True)
    return np.where(total > 0, weights / np.where(total > 0, total, 1), view_weights / view_weights.sum())
