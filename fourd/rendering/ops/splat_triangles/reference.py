"""Triangle splatting in plain torch: slow, but simple.

The reference works in float32 and float64 on any device and is differentiable through autograd. In float32, it computes
the triangles' window functions with the same operations in the same order as ``csrc/splat_triangles/maths.h``, so that
the kernels and the reference composite the same triangles at every pixel.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from fourd.base.cameras import Camera

MAX_ALPHA = 0.99
MIN_TRANSMITTANCE = 1e-4
SMALLEST_WINDOW = 1e-7
THINNEST_PX = 1e-4
FARTHEST_PX = 2.0**24
CHUNK = 1 << 21
"""Maximum product of the numbers of pixels and triangles per chunk, which limits memory."""


class Projected(NamedTuple):
    """M triangles projected to the image. All arrays have the shape (M,), except ``slope_x`` and ``slope_y`` (M, 3).
    (``x``, ``y``) is the incentre in pixels. The signed distances from the three edges, scaled to 1 at the incentre,
    have the slopes ``slope_x`` and ``slope_y`` per pixel. The minimum of the three distances is the triangle's window
    function. ``smallest`` is the value of the window function at which alpha is 1/255, but at least SMALLEST_WINDOW."""

    x: Tensor
    y: Tensor
    slope_x: Tensor
    slope_y: Tensor
    smallest: Tensor
    opacity: Tensor
    sigma: Tensor


def splat_triangles_reference(
    xyz: Tensor,
    tri: Tensor,
    features: Tensor,
    opacity: Tensor,
    sigma: Tensor,
    camera: Camera,
    layers: int,
    near: float,
) -> tuple[Tensor, Tensor, Tensor]:
    """Compute the composited features (H, W, C), alpha (H, W), and each triangle's maximum compositing weight (T,) over
    all pixels."""
    kept = _cull(project_corners(xyz.detach(), tri, camera), opacity.detach(), sigma.detach(), near)
    projected = _project(project_corners(xyz, tri[kept], camera), opacity[kept], sigma[kept])
    colours, alphas, best = [], [], xyz.new_zeros(len(kept))
    for pixels in pixel_centres(camera, xyz).split(max(1, CHUNK // (len(kept) + 1))):
        colour, alpha, weights = _composite(projected, features[kept], pixels, layers)
        colours.append(colour)
        alphas.append(alpha)
        if len(kept) > 0:
            best = torch.maximum(best, weights.detach().amax(dim=0))
    shape = (camera.height, camera.width)
    # If every triangle is culled, adding zero keeps the image connected to the inputs in the autograd graph.
    zero = sum((array[:0].sum() for array in (features, opacity, sigma)), start=xyz[:0].sum())
    weight = xyz.new_zeros(len(tri)).index_copy(0, kept, best)
    return torch.cat(colours).reshape(*shape, -1) + zero, torch.cat(alphas).reshape(shape) + zero, weight


def project_corners(xyz: Tensor, tri: Tensor, camera: Camera) -> Tensor:
    """Return the pixel coordinates u, v and the camera depth of each triangle's three corners, (T, 3, 3)."""
    k = torch.as_tensor(camera.intrinsics.copy()).to(xyz)
    r = torch.as_tensor(camera.rotation.copy()).to(xyz)
    t = torch.as_tensor(camera.translation.copy()).to(xyz)
    corners = xyz[tri.long()]
    x, y, z = (
        r[i, 0] * corners[..., 0] + r[i, 1] * corners[..., 1] + r[i, 2] * corners[..., 2] + t[i] for i in range(3)
    )
    u = (k[0, 0] * x + k[0, 1] * y) / z + k[0, 2]
    v = (k[1, 0] * x + k[1, 1] * y) / z + k[1, 2]
    return torch.stack([u, v, z], dim=-1)


def _cull(corners: Tensor, opacity: Tensor, sigma: Tensor, near: float) -> Tensor:
    """Return the indices of the triangles that are not culled, nearest first. Triangles of equal depth are sorted by
    index."""
    z = corners[..., 2]
    keep = triangles_in_range(corners, near) & (opacity * 255 >= 1) & (sigma > 0)
    keep &= torch.isfinite(opacity * 255) & torch.isfinite(sigma)
    index = torch.nonzero(keep)[:, 0]
    depth = (z[:, 0] + z[:, 1] + z[:, 2]) / 3
    return index[torch.argsort(depth[index], stable=True)]


def triangles_in_range(corners: Tensor, near: float) -> Tensor:
    """Return a mask (T,) of the projected triangles whose depths, pixel coordinates and inradii are in range."""
    u, v, z = corners.unbind(-1)
    _, _, length, area = edges_of(u, v)
    perimeter = length[:, 0] + length[:, 1] + length[:, 2]
    keep = area.abs() > torch.as_tensor(THINNEST_PX, dtype=u.dtype) * perimeter
    keep &= ((z >= torch.as_tensor(near, dtype=z.dtype)) & (z <= 1e38)).all(dim=1)
    return keep & ((u.abs() <= FARTHEST_PX) & (v.abs() <= FARTHEST_PX)).all(dim=1)


def edges_of(u: Tensor, v: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return the x components, y components and lengths of the edges, each (M, 3), and twice the signed areas (M,).
    Edge k runs from vertex k + 1 to vertex k + 2, modulo 3."""
    x = u[:, [2, 0, 1]] - u[:, [1, 2, 0]]
    y = v[:, [2, 0, 1]] - v[:, [1, 2, 0]]
    # The square roots are computed in float64, because torch rounds float32 square roots incorrectly on some
    # processors, and thin triangles amplify the error.
    length = (x * x + y * y).double().sqrt().to(x)
    return x, y, length, x[:, 1] * y[:, 2] - x[:, 2] * y[:, 1]


def _project(corners: Tensor, opacity: Tensor, sigma: Tensor) -> Projected:
    u, v, _ = corners.unbind(-1)
    x, y, length, area = edges_of(u, v)
    perimeter = length[:, 0] + length[:, 1] + length[:, 2]
    centre_x = u[:, 0] + (length[:, 1] * x[:, 2] - length[:, 2] * x[:, 1]) / perimeter
    centre_y = v[:, 0] + (length[:, 1] * y[:, 2] - length[:, 2] * y[:, 1]) / perimeter
    scale = perimeter[:, None] / (area[:, None] * length)
    # Value of the window function at which alpha = opacity * window^sigma is exactly 1/255, computed in float64.
    power = torch.exp2(-torch.log2(opacity.detach().double() * 255) / sigma.detach().double())
    smallest = power.clamp(min=SMALLEST_WINDOW).to(opacity)
    return Projected(centre_x, centre_y, -y * scale, x * scale, smallest, opacity, sigma)


def pixel_centres(camera: Camera, like: Tensor) -> Tensor:
    """Return the pixel centres (H * W, 2), row by row."""
    rows = torch.arange(camera.height, dtype=like.dtype, device=like.device) + 0.5
    columns = torch.arange(camera.width, dtype=like.dtype, device=like.device) + 0.5
    return torch.stack(torch.meshgrid(columns, rows, indexing="xy"), dim=-1).reshape(-1, 2)


def _composite(projected: Projected, features: Tensor, pixels: Tensor, layers: int) -> tuple[Tensor, Tensor, Tensor]:
    """Composite front to back. Return features (P, C), alpha (P,) and weights (P, M)."""
    dx = pixels[:, :1] - projected.x
    dy = pixels[:, 1:] - projected.y
    a = [1 + projected.slope_x[:, k] * dx + projected.slope_y[:, k] * dy for k in range(3)]
    # torch.where gives the whole gradient to the first of several equal values; torch.minimum would divide it among
    # them.
    rest = torch.where(a[1] <= a[2], a[1], a[2])
    window = torch.where(a[0] <= rest, a[0], rest)
    hit = window >= projected.smallest
    safe = torch.where(hit, window, torch.ones_like(window))
    value = projected.opacity * torch.exp2(projected.sigma * torch.log2(safe))
    alpha = torch.where(hit, torch.where(value <= MAX_ALPHA, value, torch.full_like(value, MAX_ALPHA)), 0)
    transmittance = pixels.new_ones(len(pixels))
    remaining = torch.full((len(pixels),), layers, device=pixels.device)
    columns, colour = [], pixels.new_zeros(len(pixels), features.shape[1])
    for index in range(alpha.shape[1]):
        # The triangles are in depth order. Compositing of a pixel ends when its transmittance is too small or
        # ``layers`` triangles are composited.
        taken = hit[:, index] & (transmittance > MIN_TRANSMITTANCE) & (remaining > 0)
        weight = torch.where(taken, transmittance * alpha[:, index], 0)
        colour = colour + torch.where(taken[:, None], weight[:, None] * features[index], 0)
        transmittance = torch.where(taken, transmittance * (1 - alpha[:, index]), transmittance)
        remaining = remaining - taken.to(remaining.dtype)
        columns.append(weight.detach())
    weights = torch.stack(columns, dim=1) if columns else pixels.new_zeros(len(pixels), 0)
    return colour, 1 - transmittance, weights
