"""Sub-pixel positions of a board's inner corners, as saddle points of the brightness.

A quadratic polynomial is fitted to the brightness in a patch around an inner corner. The saddle point of the polynomial
is the position of the corner (Lucchese and Mitra, Using saddle points for subpixel feature detection in camera
calibration targets, APCCAS 2002). The patch is aligned with the board's axes and ends before the nearest marker, so
that markers do not shift the corner.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

HALF_SAMPLES = 4
"""Number of samples on each side of the patch's centre, along each axis."""
MIN_HALF_PX = 2.0
"""Minimum distance from the centre of the patch to its edge, in pixels. Smaller patches have too few pixels."""
MAX_STEPS = 8
MAX_STEP = 0.5
"""Maximum distance, along each axis of the patch, by which one iteration moves a corner. It is given as a fraction of
half the patch's side length."""
MAX_MOVE_PX = 3.0
"""Maximum distance by which a corner may move. Beyond this distance, the search has found another saddle point."""
CONVERGED_PX = 1e-3


def refine_corners(grey: Grey, flat: Array, pixels: Array, half: float) -> tuple[Array, NDArray[np.bool_]]:
    """Move corners to the saddle points of the brightness.

    Args:
        grey: image (H, W) uint8.
        flat: (N, 2) corners on the board, in squares; at least four, not on one line.
        pixels: (N, 2) corners in OpenCV's pixel coordinates, with errors of up to about 2 pixels.
        half: distance from the centre of the patch to its edge, in squares.

    Returns:
        corners (N, 2) in OpenCV's pixel coordinates, and a mask (N,) of the corners for which a saddle point was
        found. Corners without a saddle point are unchanged.
    """
    axes = _patch_axes(flat, pixels, half)
    if axes is None:
        return pixels, np.zeros(len(pixels), bool)
    steps = np.linspace(-1, 1, 2 * HALF_SAMPLES + 1)
    u, v = (each.ravel() for each in np.meshgrid(steps, steps))
    terms = np.stack([u * u, u * v, v * v, u, v, np.ones_like(u)], axis=1)
    weight = np.exp(-(u * u + v * v))[:, None]
    solve = np.linalg.pinv(terms * weight) * weight.T
    offsets = np.einsum("nij,sj->nsi", axes, np.stack([u, v], axis=1))
    found, is_saddle = pixels.copy(), np.ones(len(pixels), bool)
    for _ in range(MAX_STEPS):
        places = (found[:, None] + offsets).astype(np.float32)
        values = cv2.remap(grey, places[..., 0], places[..., 1], cv2.INTER_CUBIC).astype(np.float64)
        a, b, c, d, e, _ = (values @ solve.T).T
        determinant = 4 * a * c - b * b
        is_saddle &= determinant < 0
        safe = np.where(is_saddle, determinant, -1.0)
        move = np.stack([b * e - 2 * c * d, b * d - 2 * a * e], axis=1) / safe[:, None]
        step = np.einsum("nij,nj->ni", axes, np.clip(move, -MAX_STEP, MAX_STEP)) * is_saddle[:, None]
        found = found + step
        if np.abs(step).max() < CONVERGED_PX:
            break
    is_saddle &= np.linalg.norm(found - pixels, axis=1) <= MAX_MOVE_PX
    return np.where(is_saddle[:, None], found, pixels), is_saddle


def _patch_axes(flat: Array, pixels: Array, half: float) -> Array | None:
    """Return one matrix (2, 2) per corner, as an array (N, 2, 2). Its columns are the vectors, in pixels, from the
    centre of the corner's patch to the midpoints of two adjacent edges. Returns None if no homography fits the
    corners."""
    homography, _ = cv2.findHomography(flat, pixels, cv2.LMEDS)
    if homography is None:
        return None
    # Each corner and two points beside it are mapped by the homography. The differences between the mapped points
    # approximate the derivative of the homography at the corner.
    ends = [np.column_stack([flat + step, np.ones(len(flat))]) @ homography.T for step in ((0, 0), (0.5, 0), (0, 0.5))]
    if any((np.abs(end[:, 2]) < 1e-9).any() for end in ends):
        return None
    middle, right, up = (end[:, :2] / end[:, 2:] for end in ends)
    axes = 2 * half * np.stack([right - middle, up - middle], axis=2)
    lengths = np.linalg.norm(axes, axis=1, keepdims=True)
    return np.asarray(axes * np.maximum(1.0, MIN_HALF_PX / np.maximum(lengths, 1e-6)), np.float64)
