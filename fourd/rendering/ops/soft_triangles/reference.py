"""Soft rasterization in plain torch: slow, but simple.

The reference works in float32 and float64 on any device and is differentiable through autograd. In float32, it computes
coverages and depths with the same operations in the same order as ``csrc/soft_triangles/maths.h``.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.rendering.ops.soft_triangles.softness import Softness
from fourd.rendering.ops.splat_triangles.reference import edges_of, pixel_centres, project_corners, triangles_in_range

CHUNK = 1 << 21
"""Maximum product of the numbers of pixels and triangles per chunk, which limits memory."""


def rasterize_soft_reference(
    xyz: Tensor, tri: Tensor, features: Tensor, camera: Camera, softness: Softness, layers: int
) -> tuple[Tensor, Tensor]:
    """Compute the features (H, W, C) and the alpha (H, W) of :func:`fourd.rendering.triangles.rasterize_soft`."""
    corners = project_corners(xyz.detach(), tri, camera)
    kept = torch.nonzero(triangles_in_range(corners, softness.near))[:, 0]
    corners = project_corners(xyz, tri[kept], camera)
    pixel = 2 / min(camera.width, camera.height)
    sharpness = (1 if softness.barycentric else pixel * pixel) / softness.sigma
    chunks = [
        _render(corners, features[kept], pixels, softness, sharpness, layers)
        for pixels in pixel_centres(camera, xyz).split(max(1, CHUNK // (len(kept) + 1)))
    ]
    colour, alpha = (torch.cat(chunk) for chunk in zip(*chunks, strict=True))
    # If every triangle is culled, adding zero keeps the image connected to the inputs in the autograd graph.
    zero = xyz[:0].sum() + features[:0].sum()
    shape = (camera.height, camera.width)
    return colour.reshape(*shape, -1) + zero, alpha.reshape(shape) + zero


def _render(
    corners: Tensor, features: Tensor, pixels: Tensor, softness: Softness, sharpness: float, layers: int
) -> tuple[Tensor, Tensor]:
    """Render P pixels. Return features (P, C) and alpha (P,)."""
    odds, depth = _coverage(corners, pixels, softness, sharpness)
    hit = (odds >= -math.log(1 / softness.cutoff - 1)) & (depth <= softness.far)
    hit = _nearest(hit, depth.detach(), layers)
    odds, depth = torch.where(hit, odds, 0), torch.where(hit, depth, 1)
    covered, uncovered = torch.sigmoid(odds), torch.sigmoid(-odds)
    alpha = 1 - torch.where(hit, uncovered, 1).prod(dim=1)
    background = softness.far - softness.eps * (softness.far - softness.near)
    per_depth = 1 / ((softness.far - softness.near) * softness.gamma)
    ends = torch.cat([depth.new_full((len(pixels), 1), background), torch.where(hit, depth, background)], dim=1)
    nearest = ends.detach().amin(dim=1, keepdim=True)
    weights = torch.where(hit, covered * torch.exp((nearest - depth) * per_depth), 0)
    total = weights.sum(dim=1, keepdim=True) + torch.exp((nearest - background) * per_depth)
    return (weights @ features) / total, alpha


def _coverage(corners: Tensor, pixels: Tensor, softness: Softness, sharpness: float) -> tuple[Tensor, Tensor]:
    """Return the log-odds of the coverage D, and the camera depth, of T triangles at P pixels, each (P, T)."""
    u, v, z = corners.unbind(-1)
    _, _, length, area = edges_of(u, v)
    centre_x, centre_y = (u[:, 0] + u[:, 1] + u[:, 2]) / 3, (v[:, 0] + v[:, 1] + v[:, 2]) / 3
    # The centroid is only an origin that keeps rounding errors small, so autograd may treat it as a constant.
    centre_x, centre_y = centre_x.detach(), centre_y.detach()
    u, v = u - centre_x[:, None], v - centre_y[:, None]
    to_x, to_y = u - (pixels[:, :1] - centre_x)[..., None], v - (pixels[:, 1:] - centre_y)[..., None]
    following, last = [1, 2, 0], [2, 0, 1]
    edge_x, edge_y = u[:, last] - u[:, following], v[:, last] - v[:, following]
    cross = to_x[..., following] * to_y[..., last] - to_x[..., last] * to_y[..., following]
    barycentric = cross * (1 / area)[:, None]
    smallest = barycentric.amin(dim=2)
    if softness.barycentric:
        square = smallest * smallest
    else:
        dot = -to_x[..., following] * edge_x - to_y[..., following] * edge_y
        along = (dot * (1 / (length * length))).clamp(0, 1)
        off_x, off_y = -to_x[..., following] - along * edge_x, -to_y[..., following] - along * edge_y
        square = (off_x * off_x + off_y * off_y).amin(dim=2)
    odds = torch.where(smallest > 0, square * sharpness, -square * sharpness)
    a, b, c = barycentric.clamp(min=0).unbind(-1)
    inverse_z = 1 / z
    inverse = (a * inverse_z[:, 0] + b * inverse_z[:, 1] + c * inverse_z[:, 2]) / (a + b + c)
    return odds, 1 / inverse


def _nearest(hit: Tensor, depth: Tensor, layers: int) -> Tensor:
    """Restrict hits (P, T) to each pixel's ``layers`` nearest triangles. At equal depth, the triangle with the smaller
    index counts as nearer."""
    if hit.shape[1] <= layers:
        return hit
    order = torch.where(hit, depth, math.inf).argsort(dim=1, stable=True)
    place = torch.empty_like(order).scatter_(1, order, torch.arange(hit.shape[1]).to(order).expand_as(order))
    return hit & (place < layers)
