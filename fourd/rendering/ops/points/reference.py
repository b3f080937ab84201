"""The reference point renderer in plain torch, with which tests compare the other backends: slow, but simple.

The renderer works in float32 and float64 on any device and is differentiable through autograd. In float32, it computes
depth, projection and alpha with the same operations in the same order as ``csrc/points/maths.h``, so that the kernels
and the reference composite the same points at every pixel.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from fourd.base.cameras import Camera

CHUNK = 1 << 23
"""Maximum product of the numbers of pixels and points per chunk, which limits memory to about 100 MB."""


class Splats(NamedTuple):
    """M points projected to the image. The arrays have the shape (M,). ``inverse_square`` is 1 / radius_px^2."""

    u: Tensor
    v: Tensor
    inverse_square: Tensor
    density: Tensor
    z: Tensor


class Layers(NamedTuple):
    """The indices (P, K) of the splats that are composited in the K depth layers of each of P pixels, nearest first.

    If a pixel has fewer than K splats, ``valid`` is False and ``splat`` is 0 in its unused layers.
    """

    splat: Tensor
    valid: Tensor


def render_points_reference(
    xyz: Tensor, features: Tensor, radius: Tensor, density: Tensor, camera: Camera, layers: int, near: float
) -> tuple[Tensor, Tensor, Tensor]:
    """Compute features (H, W, C), alpha (H, W) and depth (H, W) of :func:`fourd.rendering.render_points`."""
    kept = _cull(xyz, radius, density, camera, near)
    splats = _project(xyz[kept], radius[kept], density[kept], camera)
    features = features[kept]
    chunks = [_composite(splats, features, *chunk)[:3] for chunk in _pixel_chunks(splats, camera, layers)]
    colour, alpha, depth = (torch.cat(chunk) for chunk in zip(*chunks, strict=True))
    shape = (camera.height, camera.width)
    # If every point is culled, adding zero keeps the image connected to the inputs in the autograd graph.
    zero = sum((array[:0].sum() for array in (features, radius, density)), start=xyz[:0].sum())
    return colour.reshape(*shape, features.shape[1]) + zero, alpha.reshape(shape) + zero, depth.reshape(shape)


@torch.no_grad()
def point_visibility_reference(
    xyz: Tensor, radius: Tensor, density: Tensor, camera: Camera, layers: int, near: float
) -> Tensor:
    """Compute the (N,) weights of :func:`fourd.rendering.point_visibility`."""
    kept = _cull(xyz, radius, density, camera, near)
    splats = _project(xyz[kept], radius[kept], density[kept], camera)
    best = xyz.new_zeros(kept.shape[0])
    for pixels, chosen in _pixel_chunks(splats, camera, layers):
        weights = _composite(splats, xyz.new_zeros(kept.shape[0], 1), pixels, chosen)[3]
        best.scatter_reduce_(0, chosen.splat.reshape(-1), weights.reshape(-1), "amax")
    return xyz.new_zeros(xyz.shape[0]).index_copy_(0, kept, best)


@torch.no_grad()
def _cull(xyz: Tensor, radius: Tensor, density: Tensor, camera: Camera, near: float) -> Tensor:
    """Return the indices of the points that are not culled, nearest first. Points of equal depth are sorted by
    index."""
    u, v, inverse_square, _, z = _project(xyz, radius, density, camera)
    keep = (z >= torch.as_tensor(near, dtype=xyz.dtype)) & (radius > 0) & (density > 0) & (inverse_square > 0)
    for value in (z, radius, density, u, v, inverse_square):
        keep &= torch.isfinite(value)
    index = torch.nonzero(keep)[:, 0]
    return index[torch.argsort(z[index], stable=True)]


def _project(xyz: Tensor, radius: Tensor, density: Tensor, camera: Camera) -> Splats:
    k = torch.as_tensor(camera.intrinsics.copy()).to(xyz)
    r = torch.as_tensor(camera.rotation.copy()).to(xyz)
    t = torch.as_tensor(camera.translation.copy()).to(xyz)
    x, y, z = (r[i, 0] * xyz[:, 0] + r[i, 1] * xyz[:, 1] + r[i, 2] * xyz[:, 2] + t[i] for i in range(3))
    u = (k[0, 0] * x + k[0, 1] * y) / z + k[0, 2]
    v = (k[1, 0] * x + k[1, 1] * y) / z + k[1, 2]
    rho = k[1, 1] * radius / z
    return Splats(u, v, 1 / (rho * rho), density.clamp(max=1), z)


def _alpha(splats: Splats, pixels: Tensor) -> Tensor:
    """Return density * (1 - distance_px^2 / radius_px^2), where distance_px is the distance from the pixel to the
    splat's centre. The result is negative outside the splat.

    The arrays of ``splats`` have the shape (P, K), or (1, M) to evaluate all M splats at every pixel. ``pixels`` (P, 2)
    are the pixel centres.
    """
    dx = splats.u - pixels[:, :1]
    dy = splats.v - pixels[:, 1:]
    return splats.density * (1 - (dx * dx + dy * dy) * splats.inverse_square)


def _pixel_chunks(splats: Splats, camera: Camera, layers: int) -> list[tuple[Tensor, Layers]]:
    """Split the image into chunks of pixels. Return each chunk's pixel centres (P, 2), in row-major order, and the
    splats that are composited in each pixel."""
    rows = torch.arange(camera.height, dtype=splats.z.dtype, device=splats.z.device) + 0.5
    columns = torch.arange(camera.width, dtype=splats.z.dtype, device=splats.z.device) + 0.5
    pixels = torch.stack(torch.meshgrid(columns, rows, indexing="xy"), dim=-1).reshape(-1, 2)
    return [(chunk, _choose(splats, chunk, layers)) for chunk in pixels.split(max(1, CHUNK // (len(splats.z) + 1)))]


@torch.no_grad()
def _choose(splats: Splats, pixels: Tensor, layers: int) -> Layers:
    """Select the nearest ``layers`` splats with positive alpha at every pixel. ``splats`` must be sorted by depth."""
    count = len(splats.z)
    hit = _alpha(Splats(*(value[None] for value in splats)), pixels) > 0
    order = torch.where(hit, torch.arange(count, device=hit.device), count)
    index = order.topk(min(layers, count), dim=1, largest=False, sorted=True).values
    valid = index < count
    return Layers(torch.where(valid, index, 0), valid)


def _composite(
    splats: Splats, features: Tensor, pixels: Tensor, chosen: Layers
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Composite front to back. Return features (P, C), alpha (P,), depth (P,) and the layers' weights (P, K)."""
    local = Splats(*(value[chosen.splat] for value in splats))
    alphas = torch.where(chosen.valid, _alpha(local, pixels), 0)
    zero = pixels[:, 0] * 0
    transmittance, total, offset, colour = zero + 1, zero, zero, zero[:, None].expand(-1, features.shape[1])
    # The nearest depth is subtracted before the depths are averaged, and added again after. Without the subtraction,
    # the division by a small weight would amplify a rounding error in pixels with one layer. Autograd may treat the
    # subtracted depth as a constant, because the mean depth and its gradient are the same for any subtracted constant.
    nearest = torch.where(chosen.valid, local.z, 0)[:, :1].detach().sum(dim=1)
    weights = []
    for k in range(alphas.shape[1]):
        valid = chosen.valid[:, k]
        weight = transmittance * alphas[:, k]
        layer = torch.where(valid[:, None], features[chosen.splat[:, k]], 0)
        colour = colour + weight[:, None] * layer
        total = total + weight
        offset = offset + weight * torch.where(valid, local.z[:, k] - nearest, 0)
        transmittance = transmittance * (1 - alphas[:, k])
        weights.append(weight)
    alpha = 1 - transmittance
    covered = alpha > 0
    depth = torch.where(covered, nearest + offset / torch.where(covered, total, 1), 0)
    return colour, alpha, depth, torch.stack(weights, dim=1) if weights else alphas
