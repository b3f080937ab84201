"""The differentiable point renderer for torch tensors (public API)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from fourd.cameras import Camera
from fourd.ops.gpu import cuda_unavailable_reason
from fourd.ops.points import op
from fourd.ops.points.reference import point_visibility_reference, render_points_reference
from fourd.ops.points.validation import check_background, check_points, pack_camera

Backend = Literal["auto", "reference", "cpu", "cuda"]


@dataclass(frozen=True)
class PointRender:
    """A rendered image.

    Attributes:
        features: (H, W, C) composited features, over the background if one is given.
        alpha: (H, W) opacity in [0, 1].
        depth: (H, W) weighted mean of the composited points' camera depths, in world units; 0 where alpha is 0.
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

    A point i at camera depth z_i, with projected centre q_i and a radius of rho_i = K[1, 1] * radius_i / z_i pixels,
    has alpha_i(p) = density_i * max(1 - |q_i - p|^2 / rho_i^2, 0) at pixel centre p. The points with alpha_i(p) > 0
    are sorted by z, ties by index; the first ``layers`` are composited over the background.

    Gradients flow from all three outputs to xyz, features, radius, density and background; the choice of points is
    constant. On the CPU the result and its gradients have the same bits for any number of threads.

    Args:
        xyz: (N, 3) positions, world units.
        features: (N, C) colours or other features, C from 1 to 32. Values are not checked: one that is not finite
            appears in the pixels that composite its point.
        radius: (N,) world units.
        density: (N,) peak alpha in [0, 1]; larger values count as 1.
        camera: a pinhole camera without lens distortion.
        layers: K, the most points that a pixel composites.
        near: camera depth, in world units, below which points are culled. Also culled, with zero gradients, are
            points with a radius or density that is not positive, and points whose position, radius, density or
            projection is not finite.
        background: (C,) or (H, W, C), composited with 1 - alpha; None for zeros.
        backend: "reference" (plain torch, float32 or float64, slow), "cpu" (float32), "cuda" (float32), or "auto" for
            the kernel of the tensors' device.
        transmittance_min: a pixel ends below this transmittance. 0 is exact and required for gradients; 1e-4 saves
            time. The reference is always exact.
        threads: for "cpu"; 0 uses FOURD_THREADS if set, else torch.get_num_threads().

    Raises:
        TypeError, ValueError: for an invalid argument. The message names the argument and the expected value.
        RuntimeError: if the backend is not built.
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
    """Compute every point's largest weight (transmittance times alpha) in any pixel of ``camera``.

    Arguments, culling and errors are those of :func:`render_points`.

    Returns:
        (N,) weights in [0, 1] of xyz's dtype, without gradient; 0 for points that are not visible.
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
            "backend: expected one that this installation has, got 'cuda', but fourd was built without it "
            f"({missing}); install CUDA's compiler nvcc and then fourd again, move the tensors to the CPU, or use "
            "backend='reference', which runs on any device"
        )
    if device != required:
        raise ValueError(
            f"xyz: expected a tensor on {required!r} for backend {backend!r}, got one on {device!r}; "
            "backend='reference' runs on any device"
        )
    return "native"
