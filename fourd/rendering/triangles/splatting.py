"""Triangle splatting for torch tensors: :func:`splat_triangles`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.rendering.ops.meshes.backends import Backend, select_backend
from fourd.rendering.ops.meshes.checks import check_layers, check_tensor, check_triangles
from fourd.rendering.ops.points.validation import check_camera, pack_camera
from fourd.rendering.ops.splat_triangles import op
from fourd.rendering.ops.splat_triangles.reference import splat_triangles_reference

MAX_CHANNELS = 32
LARGEST_COORDINATE = 1e9
"""When normals and depths are computed, coordinates of at least this absolute value are treated as 0, because their
squares could overflow."""


@dataclass(frozen=True)
class TriangleRender:
    """A rendered image.

    Attributes:
        features: (H, W, C) composited features.
        alpha: (H, W) opacity in [0, 1].
        depth: (H, W) weighted mean of the camera depths of the composited triangles' centres in world units, 0 where
            ``alpha`` is 0. A triangle's weight is its alpha times the transmittance in front of it. None if
            ``geometry`` is False.
        normal: (H, W, 3) sum of the composited triangles' unit normals, each multiplied by the same weight as for
            ``depth``. The normals are in world coordinates and point towards the camera. None if ``geometry`` is False.
        weight: (T,) maximum compositing weight of each triangle over all pixels, not differentiable, 0 for invisible
            triangles.
    """

    features: Tensor
    alpha: Tensor
    depth: Tensor | None
    normal: Tensor | None
    weight: Tensor


def splat_triangles(
    xyz: Tensor,
    tri: Tensor,
    features: Tensor,
    opacity: Tensor,
    sigma: Tensor | float,
    camera: Camera,
    *,
    layers: int | None = None,
    near: float = 0.01,
    geometry: bool = True,
    backend: Backend = "auto",
    threads: int = 0,
) -> TriangleRender:
    """Composite soft triangles front to back (triangle splatting, Held et al. 2025).

    The signed distance of a pixel from an edge of a projected triangle, in pixels, is negative on the inner side of the
    edge. Let phi(p) be the largest of the three signed distances of the pixel p. Let s be the triangle's incentre. The
    window function I(p) = max(phi(p) / phi(s), 0)^sigma is 1 at the incentre and 0 at the edges. The triangle's alpha
    is min(0.99, opacity * I(p)).

    At each pixel, the triangles with an alpha of at least 1/255 are composited in ascending order of their centres'
    camera depths. At equal depth, the triangle with the smaller index comes first. Compositing stops when the pixel's
    transmittance is at most 1e-4.

    The results are differentiable in ``xyz``, ``features``, ``opacity`` and ``sigma``. The backward pass treats the
    selection and the order of triangles as constant. On the CPU, results and gradients are bit-identical for any number
    of threads.

    Args:
        xyz: (V, 3) vertices in world units.
        tri: (T, 3) int32 vertex indices. Both sides of a triangle are visible.
        features: (T, C) colours or other features, with C from 1 to 32. The values are not checked.
        opacity: (T,) opacity at the incentre. Values above 1 are allowed, because alpha is clamped to 0.99.
        sigma: exponent of the window function, as a tensor (T,) or a number, positive. If it is 1, alpha decreases
            linearly from the incentre to the edges. If it is near 0, alpha is almost constant up to the edges.
        camera: a pinhole camera without lens distortion.
        layers: maximum number of triangles that are composited per pixel, or None for no limit.
        near: triangles with a vertex nearer than this camera depth, in world units, are culled. Triangles are also
            culled if their inradius is at most 1e-4 pixels, if their opacity is below 1/255, if their sigma is not
            positive, or if one of their values is not finite. Culled triangles have zero gradients.
        geometry: whether to render depths and normals. Rendering without them takes about 40% less time.
        backend: "reference" for an implementation in plain torch (slow, float32 or float64), "cpu" or "cuda" for the
            float32 kernels, or "auto" for the kernels for the tensors' device.
        threads: number of CPU threads. 0 means the environment variable FOURD_THREADS, or torch.get_num_threads().

    Raises:
        TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
        RuntimeError: if the backend was not built.
    """
    sigma = _check(xyz, tri, features, opacity, sigma, backend)
    limit = _check_limits(camera, layers, near)
    values = torch.cat([features, _geometry_of(xyz, tri, camera)], dim=1) if geometry else features
    if select_backend(backend, "xyz", xyz) == "reference":
        composited, alpha, weight = splat_triangles_reference(xyz, tri, values, opacity, sigma, camera, limit, near)
        return _split(composited, alpha, weight, geometry)
    view = (pack_camera(camera), camera.width, camera.height)
    inputs = (xyz, tri, values, opacity, sigma)
    image, alpha, _, normal, depth, weight = op.splat(*inputs, geometry, *view, limit, near, threads)
    return TriangleRender(image, alpha, depth if geometry else None, normal if geometry else None, weight)


def _split(composited: Tensor, alpha: Tensor, weight: Tensor, geometry: bool) -> TriangleRender:
    """Split the composited channels into features, normals and depth."""
    if not geometry:
        return TriangleRender(composited, alpha, None, None, weight)
    depth = torch.where(alpha > 0, composited[..., -1] / torch.where(alpha > 0, alpha, 1), 0)
    return TriangleRender(composited[..., :-4], alpha, depth, composited[..., -4:-1], weight)


def _geometry_of(xyz: Tensor, tri: Tensor, camera: Camera) -> Tensor:
    """Return a tensor (T, 4). Each row has the unit normal of a triangle, pointing towards the camera, and the camera
    depth of the triangle's centre."""
    # Coordinates that are too large or not finite would give culled triangles NaN gradients, so they are replaced.
    xyz = torch.where(xyz.abs() < LARGEST_COORDINATE, xyz, 0)
    a, b, c = (xyz.index_select(0, tri[:, corner]) for corner in range(3))
    normal = torch.linalg.cross(b - a, c - a)
    centre = (a + b + c) / 3
    eye = torch.as_tensor(camera.centre).to(xyz)
    facing = ((eye - centre) * normal).sum(dim=1, keepdim=True).detach()
    square = (normal * normal).sum(dim=1, keepdim=True)
    # The normals of degenerate triangles are not divided by their length, which is near 0, so that their gradients stay
    # finite.
    normal = torch.where(facing < 0, -normal, normal) * torch.where(square > 1e-24, square, 1).rsqrt()
    forward = torch.as_tensor(camera.forward.copy()).to(xyz)
    depth = centre @ forward + float(camera.translation[2])
    return torch.cat([normal, depth[:, None]], dim=1)


def _check(xyz: Tensor, tri: Tensor, features: Tensor, opacity: Tensor, sigma: Tensor | float, backend: str) -> Tensor:
    """Check the tensors, and return sigma as a tensor (T,)."""
    dtypes = (torch.float32, torch.float64) if backend == "reference" else (torch.float32,)
    xyz = check_tensor("xyz", xyz, ("V", 3), dtypes=dtypes)
    like = ("xyz", xyz)
    count = check_triangles(tri, xyz.shape[0], like).shape[0]
    check_tensor("features", features, (count, "C"), like=like)
    if not 1 <= features.shape[1] <= MAX_CHANNELS:
        raise ValueError(f"features: expected 1 to {MAX_CHANNELS} channels, got {features.shape[1]}")
    check_tensor("opacity", opacity, (count,), like=like)
    if isinstance(sigma, Tensor):
        return check_tensor("sigma", sigma, (count,), like=like)
    if isinstance(sigma, bool) or not isinstance(sigma, int | float):
        raise TypeError(f"sigma: expected a torch.Tensor or a number, got {type(sigma).__name__}")
    if not (sigma > 0 and math.isfinite(sigma)):
        raise ValueError(f"sigma: expected a finite number above 0, got {sigma}")
    return xyz.new_full((count,), float(sigma))


def _check_limits(camera: Camera, layers: int | None, near: float) -> int:
    """Check ``camera``, ``layers`` and ``near``, and return the number of layers."""
    check_camera(camera)
    if not (near > 0 and math.isfinite(near)):
        raise ValueError(f"near: expected a finite distance above 0, got {near}")
    return check_layers(layers)
