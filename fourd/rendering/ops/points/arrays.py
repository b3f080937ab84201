"""Composites points in NumPy arrays with the CPU kernels, without torch and without gradients."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.rendering.ops.loading import load_native, simd_name, thread_count
from fourd.rendering.ops.points.validation import check_background, check_points, pack_camera

Floats = NDArray[np.float32]


def render_points_numpy(
    xyz: Floats,
    features: Floats,
    radius: Floats,
    density: Floats,
    camera: Camera,
    *,
    layers: int = 15,
    near: float = 0.01,
    background: Floats | None = None,
    transmittance_min: float = 0.0,
    threads: int = 0,
) -> tuple[Floats, Floats, Floats]:
    """Render points given as float32 arrays.

    For the arguments, see :func:`fourd.rendering.render_points`, whose CPU backend gives bit-identical results.

    If ``threads`` is 0, the environment variable FOURD_THREADS sets the number of threads. If it is not set either, all
    cores are used.

    Returns:
        features (H, W, C), alpha (H, W) and depth (H, W), float32.

    Raises:
        TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
    """
    arrays = {"xyz": xyz, "features": features, "radius": radius, "density": density}
    check_points(arrays, camera, layers, near)
    if not 0 <= transmittance_min < 1:
        raise ValueError(f"transmittance_min: expected 0 or more and below 1, got {transmittance_min}")
    shape = (camera.height, camera.width)
    out = np.empty((*shape, features.shape[1]), np.float32), np.empty(shape, np.float32), np.empty(shape, np.float32)
    load_native().render_points(
        *map(np.ascontiguousarray, arrays.values()),
        pack_camera(camera),
        layers,
        near,
        transmittance_min,
        thread_count(threads),
        simd_name(),
        *out,
    )
    colour, alpha, depth = out
    if background is not None:
        check_background(background, camera, features.shape[1])
        colour = colour + (1 - alpha)[..., None] * np.asarray(background, np.float32)
    return colour, alpha, depth


def point_visibility_numpy(
    xyz: Floats,
    radius: Floats,
    density: Floats,
    camera: Camera,
    *,
    layers: int = 15,
    near: float = 0.01,
    threads: int = 0,
) -> Floats:
    """Compute the (N,) float32 weights of :func:`fourd.rendering.point_visibility`, which has the same arguments."""
    arrays: dict[str, Any] = {"xyz": xyz, "radius": radius, "density": density}
    check_points(arrays, camera, layers, near)
    out = np.empty(radius.shape, np.float32)
    size = (camera.width, camera.height)
    load_native().point_visibility(
        *map(np.ascontiguousarray, arrays.values()),
        pack_camera(camera),
        *size,
        layers,
        near,
        thread_count(threads),
        simd_name(),
        out,
    )
    return out
