"""Colour of baked points seen from a camera: a blend of the nearest views and spherical harmonics.

``shade`` takes the native kernel where it was built; ``shade_reference`` is the same in plain
NumPy, and what the kernel is held to.
"""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from fourd.baking.scene import BakedFrame, SceneManifest
from fourd.cameras import Camera, nearest_views
from fourd.ops.loading import simd_name, thread_count

_CHUNK = 1 << 15
Floats64 = NDArray[np.float64]


def shade(frame: BakedFrame, camera: Camera, manifest: SceneManifest, *, threads: int = 0) -> NDArray[np.float32]:
    """RGB of every point as ``camera`` sees it, (N, 3) float32, not clamped.

    The ``manifest.neighbours`` source views nearest to the camera by angle at ``manifest.focus``
    are blended by their weights, normalised over the chosen views (evenly where all are 0), and
    ``sh_base + sh_range * tanh(sh . Y(d))`` is added, d the unit vector from camera to point.

    Args:
        frame: finite, as :class:`fourd.baking.container.SceneReader` guarantees.
        threads: of the native kernel; 0 for FOURD_THREADS if that is set, else one a core.
    """
    native = _native()
    if native is None:
        return shade_reference(frame, camera, manifest)
    return native.shade(
        frame.xyz,
        frame.sh.view(np.uint16),
        frame.blend_weights.view(np.uint16),
        frame.rgb,
        *shading_arguments(camera, manifest),
        thread_count(threads),
        simd_name(),
    )


def shade_reference(frame: BakedFrame, camera: Camera, manifest: SceneManifest) -> NDArray[np.float32]:
    """What :func:`shade` promises, in NumPy; slower, and obvious."""
    chosen = select_source_views(camera, manifest)
    colour = np.empty((frame.point_count, 3), dtype=np.float32)
    for start in range(0, frame.point_count, _CHUNK):
        part = slice(start, start + _CHUNK)
        towards = frame.xyz[part].astype(np.float64) - camera.centre
        length = np.linalg.norm(towards, axis=1, keepdims=True)
        directions = (towards / np.maximum(length, 1e-12)).astype(np.float32)
        harmonics = np.einsum("nck,nk->nc", frame.sh[part].astype(np.float32), sh_basis(directions))
        colour[part] = manifest.sh_base + manifest.sh_range * np.tanh(harmonics)
        if chosen:
            weights = _normalised(frame.blend_weights[part][:, chosen].astype(np.float32))
            rgb = frame.rgb[part][:, chosen].astype(np.float32) / 255
            colour[part] += np.einsum("nv,nvc->nc", weights, rgb)
    return colour


def select_source_views(camera: Camera, manifest: SceneManifest) -> list[int]:
    """Indices of the source views that are blended for ``camera``; empty when the scene has none."""
    sources = list(manifest.source_cameras)
    return nearest_views(camera, sources, manifest.neighbours, np.asarray(manifest.focus))


def shading_arguments(camera: Camera, manifest: SceneManifest) -> tuple[NDArray[np.int32], Floats64, float, float]:
    """What the native kernels take: the views to blend, the camera's centre, and the SH part's range and base."""
    chosen = np.asarray(select_source_views(camera, manifest), dtype=np.int32)
    return chosen, np.ascontiguousarray(camera.centre), manifest.sh_range, manifest.sh_base


def sh_basis(directions: NDArray[np.float32]) -> NDArray[np.float32]:
    """The 16 real spherical harmonics of degree 3 (order and constants of PlenOctrees and 3DGS).

    directions (N, 3) unit vectors -> (N, 16).
    """
    x, y, z = directions.T
    xx, yy, zz = x * x, y * y, z * z
    terms = [
        np.full_like(x, 0.28209479177387814),
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2 * zz - xx - yy),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3 * xx - yy),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4 * zz - xx - yy),
        0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
        -0.4570457994644658 * x * (4 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3 * yy),
    ]
    return np.stack(terms, axis=1).astype(np.float32, copy=False)


def _normalised(weights: NDArray[np.float32]) -> NDArray[np.float32]:
    total = weights.sum(axis=1, keepdims=True)
    even = np.float32(1 / weights.shape[1])
    return np.where(total > 0, weights / np.where(total > 0, total, 1), even)


def _native() -> ModuleType | None:
    """The native module when it was built with the shading kernel."""
    try:
        native = import_module("fourd._native")
    except ImportError:
        return None
    return native if hasattr(native, "shade") else None
