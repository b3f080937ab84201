"""Soft rasterization for torch tensors: :func:`rasterize_soft`."""

from __future__ import annotations

import math
from typing import Literal

import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.rendering.ops.meshes.backends import Backend, select_backend
from fourd.rendering.ops.meshes.checks import check_layers, check_tensor, check_triangles
from fourd.rendering.ops.points.validation import check_camera, pack_camera
from fourd.rendering.ops.soft_triangles import op
from fourd.rendering.ops.soft_triangles.reference import rasterize_soft_reference
from fourd.rendering.ops.soft_triangles.softness import Softness

MAX_CHANNELS = 32


def rasterize_soft(
    xyz: Tensor,
    tri: Tensor,
    features: Tensor,
    camera: Camera,
    *,
    sigma: float = 1e-5,
    gamma: float = 1e-4,
    layers: int | None = 50,
    distance: Literal["euclidean", "barycentric"] = "euclidean",
    cutoff: float = 1e-4,
    near: float = 0.01,
    far: float = 100.0,
    eps: float = 1e-3,
    backend: Backend = "auto",
    threads: int = 0,
) -> tuple[Tensor, Tensor]:
    """Render triangles with soft edges and soft occlusion (SoftRas, Liu et al. 2019, equations 1 to 4).

    The soft coverage of pixel i by triangle j is D_ij = sigmoid(d_ij^2 / sigma) if the pixel's centre is inside the
    triangle, and D_ij = sigmoid(-d_ij^2 / sigma) if it is outside. The argument ``distance`` defines d_ij. The pixel's
    alpha is 1 - prod_j (1 - D_ij). Its features are the weighted mean of the features of the triangles and of the
    background. Triangle j has the weight D_ij * exp(zbar_ij / gamma). The background has the features 0 and the weight
    exp(eps / gamma). zbar_ij is the triangle's normalised depth at the pixel, which is 1 at ``near`` and 0 at ``far``.
    It is computed with barycentric coordinates that are clamped to the triangle.

    The results are differentiable in ``xyz`` and ``features``. The backward pass treats the selection of triangles as
    constant. On the CPU, results and gradients are bit-identical for any number of threads. ``backend`` and ``threads``
    are those of :func:`fourd.rendering.triangles.splat_triangles`.

    Args:
        xyz: (V, 3) vertices in world units.
        tri: (T, 3) int32 vertex indices. Both sides of a triangle are visible.
        features: (T, C) colours or other features, with C from 1 to 32. The values are not checked.
        camera: a pinhole camera without lens distortion.
        sigma: softness of the edges, positive, in the units of d_ij squared.
        gamma: temperature of the softmax over depths, positive.
        layers: number of nearest triangles per pixel, or None for all. Equal depths are ordered by triangle index.
        distance: "euclidean": d_ij is the distance from the nearest edge, in units of half of the image's shorter side.
            "barycentric": d_ij is the smallest barycentric coordinate.
        cutoff: triangles are skipped at pixels where D_ij is below this number, which is in (0, 0.5).
        near: smallest camera depth in world units. A triangle is culled if it has a vertex nearer than ``near``, if its
            inradius is at most 1e-4 pixels, or if a vertex is not finite. Culled triangles have zero gradients.
        far: largest camera depth in world units. A triangle is skipped at pixels where its depth is larger.
        eps: normalised depth of the background.

    Returns:
        features (H, W, C), and alpha (H, W) in [0, 1].

    Raises:
        TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
        RuntimeError: if the backend was not built.
    """
    _check_tensors(xyz, tri, features, camera, backend)
    limit = check_layers(layers)
    softness = _check_softness(distance, sigma, gamma, cutoff, near, far, eps)
    if select_backend(backend, "xyz", xyz) == "reference":
        return rasterize_soft_reference(xyz, tri, features, camera, softness, limit)
    view = (pack_camera(camera), camera.width, camera.height)
    return op.rasterize(xyz, tri, features, *view, softness.pack(), limit, threads)


def _check_tensors(xyz: Tensor, tri: Tensor, features: Tensor, camera: Camera, backend: str) -> None:
    check_camera(camera)
    dtypes = (torch.float32, torch.float64) if backend == "reference" else (torch.float32,)
    like = ("xyz", check_tensor("xyz", xyz, ("V", 3), dtypes=dtypes))
    count = check_triangles(tri, xyz.shape[0], like).shape[0]
    check_tensor("features", features, (count, "C"), like=like)
    if not 1 <= features.shape[1] <= MAX_CHANNELS:
        raise ValueError(f"features: expected 1 to {MAX_CHANNELS} channels, got {features.shape[1]}")


def _check_softness(
    distance: str, sigma: float, gamma: float, cutoff: float, near: float, far: float, eps: float
) -> Softness:
    if distance not in ("euclidean", "barycentric"):
        raise ValueError(f"distance: expected 'euclidean' or 'barycentric', got {distance!r}")
    for name, value in {"sigma": sigma, "gamma": gamma, "near": near}.items():
        if not (value > 0 and math.isfinite(value)):
            raise ValueError(f"{name}: expected a finite number above 0, got {value}")
    if not 0 < cutoff < 0.5:
        raise ValueError(f"cutoff: expected a number above 0 and below 0.5, got {cutoff}")
    if not (far > near and math.isfinite(far)):
        raise ValueError(f"far: expected a finite distance above near = {near}, got {far}")
    if not 0 <= eps < 1:
        raise ValueError(f"eps: expected a number from 0 to below 1, got {eps}")
    return Softness(distance == "barycentric", sigma, gamma, cutoff, near, far, eps)
