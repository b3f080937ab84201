"""Draws and depth-sorts baked points in NumPy and plain torch."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.rendering.ops.play.near_fade import fade_near
from fourd.rendering.ops.points.reference import render_points_reference
from fourd.rendering.ops.shade.reference import shade_points_reference
from fourd.rendering.ops.shade.shading import Shading

MAX_FLOAT32 = np.finfo(np.float32).max
RADIUS_MARGIN = 1 + 1e-6
"""Factor by which the kernels enlarge a point's disc before they search for the pixels that it covers.

Without it, rounding errors could make the search miss a covered pixel.
"""


def draw_points_reference(
    xyz: NDArray[np.float32],
    radius: NDArray[np.float16],
    density: NDArray[np.float16],
    sh: NDArray[np.float16],
    blend_weights: NDArray[np.float16],
    rgb: NDArray[np.uint8],
    shading: Shading,
    camera: Camera,
    *,
    layers: int,
    near: float,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> NDArray[np.float32]:
    """Compute the image of :meth:`fourd.rendering.ops.play.op.PointPlayer.draw`, without early termination of
    compositing.

    At the near plane, points fade (:mod:`fourd.rendering.ops.play.near_fade`).

    Returns:
        (H, W, 4) float32 image in [0, 1], not rounded to bytes. The channels are RGB, composited over the background,
        and alpha.
    """
    colours = shade_points_reference(xyz, sh, blend_weights, rgb, shading)
    rendered = render_points_reference(
        torch.from_numpy(xyz.copy()),
        torch.from_numpy(colours),
        torch.from_numpy(radius.astype(np.float32)),
        torch.from_numpy(fade_near(xyz, density, camera, near)),
        camera,
        layers,
        near,
    )
    image, alpha, _ = (part.numpy() for part in rendered)
    image = image + (1 - alpha)[..., None] * np.asarray(background, np.float32)
    return np.concatenate([np.clip(image, 0, 1), alpha[..., None]], axis=2)


def sort_points_reference(
    xyz: NDArray[np.float32],
    radius: NDArray[np.float16],
    density: NDArray[np.float16],
    camera: Camera,
    near: float,
) -> NDArray[np.uint32]:
    """Compute the result of :meth:`fourd.rendering.ops.play.op.PointSorter.sort` with a stable sort of float32 depths.

    The float32 operations and their order match ``csrc/points/maths.h``.
    """
    k, r, t = (value.astype(np.float32) for value in (camera.intrinsics, camera.rotation, camera.translation))
    radius_float, density_float = radius.astype(np.float32), density.astype(np.float32)
    a, b, c = xyz.T
    with np.errstate(all="ignore"):
        x, y, z = (r[i, 0] * a + r[i, 1] * b + r[i, 2] * c + t[i] for i in range(3))
        u = (k[0, 0] * x + k[0, 1] * y) / z + k[0, 2]
        v = (k[1, 0] * x + k[1, 1] * y) / z + k[1, 2]
        rho = k[1, 1] * radius_float / z
        inverse_square = np.float32(1) / (rho * rho)
        visible = (z >= np.float32(near)) & (radius_float > 0) & (density_float > 0) & (inverse_square > 0)
        for value in (z, radius_float, density_float, u, v, inverse_square):
            visible &= np.abs(value) <= MAX_FLOAT32
        visible &= _covers_pixel(u, rho, camera.width) & _covers_pixel(v, rho, camera.height)
    index = np.flatnonzero(visible)
    return index[np.argsort(z[index], kind="stable")].astype(np.uint32)


def _covers_pixel(centre: NDArray[np.float32], rho: NDArray[np.float32], size: int) -> NDArray[np.bool_]:
    """Return a mask of the discs that cover a pixel centre of the image, tested only along one image axis. ``centre``
    and ``rho`` are the position and the radius of each disc on this axis, and ``size`` is the number of pixels."""
    extent = rho.astype(np.float64) * RADIUS_MARGIN
    first = np.ceil(centre - extent - 0.5)
    last = np.floor(centre + extent - 0.5)
    return np.maximum(first, 0) <= np.minimum(last, size - 1)
