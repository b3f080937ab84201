"""Ray tracing in plain torch, which tests every ray against every triangle: slow, but simple.

In float32, the reference uses the same operations as ``csrc/rays/maths.h``, so it finds the same hits in the same
order. Its t, u and v are differentiable through autograd.
"""

from __future__ import annotations

import torch
from torch import Tensor

MAX_MAGNITUDE = 1e18
MIN_DIRECTION = 1e-18
PADDING = 2.0**-21
CHUNK = 1 << 19
"""Maximum number of ray-triangle pairs that are tested at once."""


def trace_rays_reference(
    xyz: Tensor,
    tri: Tensor,
    origins: Tensor,
    directions: Tensor,
    t_min: Tensor,
    t_max: Tensor,
    after_t: Tensor | None,
    after_triangle: Tensor | None,
    layers: int,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Compute the result of :func:`fourd.rendering.ops.rays.op.trace_rays`, in float32 or float64.

    The results t, u and v are differentiable in ``xyz``, ``origins`` and ``directions``.
    """
    rays = len(origins)
    t = origins.new_full((rays, layers), torch.inf)
    triangle = torch.full((rays, layers), -1, dtype=torch.int32, device=origins.device)
    corners = xyz.detach()[tri.long()]
    low, high = t_min.expand(rays), t_max.expand(rays)
    step = max(1, CHUNK // max(1, len(tri)))
    for begin in range(0, rays if len(tri) > 0 else 0, step):
        part = slice(begin, begin + step)
        found = _intersect(corners, origins.detach()[part], directions.detach()[part], low[part], high[part])
        if after_t is not None and after_triangle is not None:
            index = torch.arange(len(tri), device=tri.device)
            later = (found > after_t[part, None]) | (
                (found == after_t[part, None]) & (index > after_triangle[part, None])
            )
            found = torch.where(later, found, torch.nan)
        # A stable sort orders triangles of equal t by index. NaN comes last.
        ordered, index = torch.sort(found, dim=1, stable=True)
        count = min(layers, len(tri))
        is_hit = ~torch.isnan(ordered[:, :count])
        t[part, :count] = torch.where(is_hit, ordered[:, :count], torch.inf)
        triangle[part, :count] = torch.where(is_hit, index[:, :count], -1).int()
    return _with_weights(xyz, tri, origins, directions, t, triangle)


def _intersect(corners: Tensor, origins: Tensor, directions: Tensor, t_min: Tensor, t_max: Tensor) -> Tensor:
    """Return t (R, T) for each ray and triangle, which is NaN where there is no hit."""
    valid_triangle = (corners.abs() <= MAX_MAGNITUDE).flatten(1).all(1)
    kept = corners[valid_triangle]
    magnitude = kept.abs().max() if len(kept) > 0 else corners.new_zeros(())
    largest, axis = directions.abs().max(1)
    valid_ray = (directions.abs() <= MAX_MAGNITUDE).all(1) & (origins.abs() <= MAX_MAGNITUDE).all(1)
    valid_ray &= (largest >= MIN_DIRECTION) & (t_min <= t_max)
    exponent = torch.frexp(torch.where(valid_ray, largest, torch.ones_like(largest))).exponent - 1
    scale = torch.ldexp(torch.ones_like(largest), -exponent)
    scaled = torch.where(valid_ray[:, None], directions, torch.ones_like(directions)) * scale[:, None]
    t, u, v, w = _woop(corners, origins, scaled, axis)
    first, last = _box_interval(corners, origins, scaled, magnitude)
    inside = ((u >= 0) & (v >= 0) & (w >= 0)) | ((u <= 0) & (v <= 0) & (w <= 0))
    hit = inside & ((u + v) + w != 0) & (first <= last) & valid_ray[:, None] & valid_triangle
    t = torch.where(t < first, first, torch.where(t > last, last, t)) * scale[:, None]
    return torch.where(hit & (t >= t_min[:, None]) & (t <= t_max[:, None]), t, torch.nan)


def _woop(corners: Tensor, origins: Tensor, scaled: Tensor, axis: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return t and the three unnormalised barycentric coordinates, each (R, T)."""
    z = axis
    is_negative = scaled.gather(1, z[:, None])[:, 0] < 0
    x = torch.where(is_negative, (z + 2) % 3, (z + 1) % 3)
    y = torch.where(is_negative, (z + 1) % 3, (z + 2) % 3)
    along = [scaled.gather(1, each[:, None]) for each in (x, y, z)]
    shear_x, shear_y, shear_z = along[0] / along[2], along[1] / along[2], 1 / along[2]
    planar, depths = [], []
    for k in range(3):
        moved = [
            corners[:, k].T[each] - origins.gather(1, each[:, None]) for each in (x, y, z)
        ]  # The coordinates (R, T) along x, y and z, permuted so that ``axis`` is z.
        planar.append((moved[0] - shear_x * moved[2], moved[1] - shear_y * moved[2]))
        depths.append(moved[2])
    (ax, ay), (bx, by), (cx, cy) = planar
    weights = [cx * by - cy * bx, ax * cy - ay * cx, bx * ay - by * ax]
    exact = [
        (p.double() * q.double() - r.double() * s.double()).to(ax)
        for p, q, r, s in ((cx, by, cy, bx), (ax, cy, ay, cx), (bx, ay, by, ax))
    ]
    on_edge = (weights[0] == 0) | (weights[1] == 0) | (weights[2] == 0)
    u, v, w = (torch.where(on_edge, each, weight) for each, weight in zip(exact, weights, strict=True))
    t = ((u * depths[0] + v * depths[1]) + w * depths[2]) * shear_z / ((u + v) + w)
    return t, u, v, w


def _box_interval(corners: Tensor, origins: Tensor, scaled: Tensor, magnitude: Tensor) -> tuple[Tensor, Tensor]:
    """Return the first and the last t (R, T) at which each ray is in each triangle's padded bounding box."""
    farthest = torch.maximum(origins.abs().amax(1), magnitude)
    share = torch.full_like(scaled, MIN_DIRECTION)
    at_least = torch.where(scaled < 0, torch.minimum(scaled, -share), torch.maximum(scaled, share))
    inverse = 1 / at_least
    centre, width = origins * inverse, (PADDING * farthest)[:, None] * inverse.abs()
    low, high = corners.amin(1), corners.amax(1)
    first = torch.full((len(origins), len(corners)), -torch.finfo(torch.float32).max).to(corners)
    last = -first
    for k in range(3):
        negative = inverse[:, k, None] < 0
        near = torch.where(negative, high[:, k], low[:, k])
        far = torch.where(negative, low[:, k], high[:, k])
        first = torch.maximum(first, near * inverse[:, k, None] - (centre + width)[:, k, None])
        last = torch.minimum(last, far * inverse[:, k, None] - (centre - width)[:, k, None])
    return first, last


def _with_weights(
    xyz: Tensor, tri: Tensor, origins: Tensor, directions: Tensor, t: Tensor, triangle: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return t, u, v and the triangle of each hit. t, u and v solve
    ``origin + t * direction = u * a + v * b + (1 - u - v) * c``, where a, b and c are the triangle's vertices."""
    ray, layer = (triangle >= 0).nonzero(as_tuple=True)
    a, b, c = xyz[tri.long()[triangle[ray, layer].long()]].unbind(1)
    d, p, q = -directions[ray], a - c, b - c
    offset = origins[ray] - c
    determinant = (d * torch.linalg.cross(p, q)).sum(1)
    solved = [
        (offset * row).sum(1) / determinant
        for row in (torch.linalg.cross(p, q), torch.linalg.cross(q, d), torch.linalg.cross(d, p))
    ]
    return (
        t.index_put((ray, layer), solved[0]),
        torch.zeros_like(t).index_put((ray, layer), solved[1]),
        torch.zeros_like(t).index_put((ray, layer), solved[2]),
        triangle,
    )


def composite_discs_reference(
    xyz: Tensor,
    radius: Tensor,
    density: Tensor,
    colours: Tensor,
    origins: Tensor,
    directions: Tensor,
    facing: Tensor | None,
    t_min: float,
    layers: int,
) -> Tensor:
    """Compute the result (R, 4) of :meth:`fourd.rendering.ops.rays.discs.DiscTree.composite` in a slow, but simple way.
    Discs and rays must be valid."""
    away = xyz[None] - origins[:, None]
    normal = directions[:, None] if facing is None else facing.expand(len(origins), 1, 3)
    t = (away * normal).sum(-1) / (directions[:, None] * normal).sum(-1)
    square = (away - t[..., None] * directions[:, None]).square().sum(-1)
    alpha = density.clamp(max=1) * (1 - square / radius.square())
    alpha = torch.where(t >= t_min, alpha.clamp(min=0), 0)
    ordered, index = torch.sort(torch.where(alpha > 0, t, torch.inf), dim=1, stable=True)
    ordered, index = ordered[:, :layers], index[:, :layers]
    kept = torch.where(torch.isfinite(ordered), alpha.gather(1, index), 0)
    transmittance = torch.cumprod(torch.cat([kept.new_ones(len(kept), 1), 1 - kept], 1), 1)
    colour = ((transmittance[:, :-1] * kept)[..., None] * colours[index]).sum(1)
    return torch.cat([colour, 1 - transmittance[:, -1:]], 1)
