"""The differentiable point renderer for torch tensors (public API)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.rendering.ops.gpu import cuda_unavailable_reason
from fourd.rendering.ops.points import op
from fourd.rendering.ops.points.reference import point_visibility_reference, render_points_reference
from fourd.rendering.ops.points.validation import check_background, check_points, pack_camera

Backend = Literal["auto", "reference", "cpu", "cuda"]


@dataclass(frozen=True)
class PointRender:
    """A rendered image.

    Attributes:
        features: (H, W, C) composited features, including the background if one is given.
        alpha: (H, W) opacity in [0, 1].
        depth: (H, W) weighted mean of the composited points' camera depths in world units, 0 where ``alpha`` is 0. A
            point's weight is its alpha times the transmittance in front of it.
    """

    features: Tensor
    alpha: Tensor
    depth: Tensor


def render_points(
    xyz: Tensor,
    features: Tensor,
    radius: Tensor,
    density: Tensor,
    camera: Camera,
    *,
    layers: int = 15,
    near: float = 0.01,
    background: Tensor | None = None,
    backend: Backend = "auto",
    transmittance_min: float = 0.0,
    threads: int = 0,
) -> PointRender:
    """Composite the nearest ``layers`` points of every pixel front to back (differentiable peeling, 4K4D sec. 3.3).

    Let K be the intrinsic matrix, z_i the camera depth of point i, and q_i its projected centre. The point's radius in
    pixels is rho_i = K[1, 1] * radius_i / z_i, and its alpha at pixel p is alpha_i(p) = density_i * max(1 - |q_i - p|^2
    / rho_i^2, 0). The points with alpha_i(p) > 0 are composited in ascending order of (depth, index).

    The results are differentiable in all tensors. The backward pass treats the selection of points as constant. On the
    CPU, results and gradients are bit-identical for any number of threads.

    Args:
        xyz: (N, 3) positions, world units.
        features: (N, C) colours or other features, with C from 1 to 32. The values are not checked, and NaN and
            infinity propagate to all pixels in which the point is composited.
        radius: (N,) radii in world units.
        density: (N,) opacity at the centre, in [0, 1]. Values above 1 are clamped to 1.
        camera: a pinhole camera without lens distortion.
        layers: maximum number of points that are composited per pixel.
        near: points with a camera depth below ``near`` world units are culled. Points are also culled if their radius
            or density is not positive, or if their position, radius, density or projection is not finite. Culled
            points have zero gradients.
        background: (C,) or (H, W, C) background features, added with the weight 1 - alpha. None means 0.
        backend: "reference" for an implementation in plain torch (slow, float32 or float64), "cpu" or "cuda" for the
            float32 kernels, or "auto" for the kernels for the tensors' device.
        transmittance_min: compositing of a pixel stops when its transmittance falls below this value. Must be 0 if
            gradients are required; 1e-4 makes rendering faster. The "reference" backend uses 0.
        threads: number of CPU threads. 0 means the environment variable FOURD_THREADS, or torch.get_num_threads().

    Raises:
        TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
        RuntimeError: if the backend was not built.
    """
    arrays = {"xyz": xyz, "features": features, "radius": radius, "density": density}
    chosen = _check(arrays, camera, layers, near, backend)
    if not 0 <= transmittance_min < 1:
        raise ValueError(f"transmittance_min: expected 0 or more and below 1, got {transmittance_min}")
    if background is not None:
        check_background(background, camera, features.shape[1])
    if chosen == "reference":
        image = render_points_reference(xyz, features, radius, density, camera, layers, near)
    else:
        view = (pack_camera(camera), camera.width, camera.height)
        image = op.render(xyz, features, radius, density, *view, layers, near, transmittance_min, threads)
    colour, alpha, depth = image
    if background is not None:
        colour = colour + (1 - alpha)[..., None] * background.to(colour)
    return PointRender(colour, alpha, depth)


@torch.no_grad()
def point_visibility(
    xyz: Tensor,
    radius: Tensor,
    density: Tensor,
    camera: Camera,
    *,
    layers: int = 15,
    near: float = 0.01,
    backend: Backend = "auto",
    threads: int = 0,
) -> Tensor:
    """Compute every point's maximum compositing weight (transmittance times alpha) over all pixels of ``camera``.

    For the arguments, the culling and the errors, see :func:`render_points`.

    Returns:
        (N,) weights in [0, 1] with the dtype of ``xyz``, 0 for invisible points. They are not differentiable.
    """
    chosen = _check({"xyz": xyz, "radius": radius, "density": density}, camera, layers, near, backend)
    if chosen == "reference":
        return point_visibility_reference(xyz, radius, density, camera, layers, near)
    view = (pack_camera(camera), camera.width, camera.height)
    return op.visibility(xyz, radius, density, *view, layers, near, threads)


def _check(
    arrays: dict[str, Tensor], camera: Camera, layers: int, near: float, backend: str
) -> Literal["reference", "native"]:
    """Check the arguments and select the backend."""
    for name, value in arrays.items():
        if not isinstance(value, Tensor):
            raise TypeError(f"{name}: expected a torch.Tensor, got {type(value).__name__}")
    if backend not in ("auto", "reference", "cpu", "cuda"):
        raise ValueError(f"backend: expected 'auto', 'reference', 'cpu' or 'cuda', got {backend!r}")
    if backend == "reference":
        check_points(arrays, camera, layers, near, ("float32", "float64"))
        return "reference"
    check_points(arrays, camera, layers, near)
    device = arrays["xyz"].device.type
    required = ("cuda" if device == "cuda" else "cpu") if backend == "auto" else backend
    if required == "cuda" and (missing := cuda_unavailable_reason()):
        raise RuntimeError(
            "backend: expected an installed backend, got 'cuda', but fourd was built without CUDA "
            f"({missing}); install CUDA's compiler nvcc and then fourd again, move the tensors to the CPU, or use "
            "backend='reference', which runs on any device"
        )
    if device != required:
        raise ValueError(
            f"xyz: expected a tensor on {required!r} for backend {backend!r}, got one on {device!r}; "
            "backend='reference' runs on any device"
        )
    return "native"
