"""Compositing of soft triangles along rays: :func:`splat_along_rays`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import torch
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.rendering.ops.meshes.checks import check_layers, check_tensor
from fourd.rendering.ops.splat_triangles.reference import (
    MAX_ALPHA,
    MIN_TRANSMITTANCE,
    SMALLEST_WINDOW,
    edges_of,
    project_corners,
)
from fourd.rendering.rays.bvh import Bvh
from fourd.rendering.rays.tracing import Hits, trace

CHUNK_LAYERS = 16
"""Number of hits per ray that one call to the ray tracer returns."""
MIN_ALPHA = 1 / 255


@dataclass(frozen=True)
class RaySplats:
    """The result of compositing along R rays.

    Attributes:
        features: (R, C) composited features.
        alpha: (R,) opacity in [0, 1].
    """

    features: Tensor
    alpha: Tensor


def splat_along_rays(
    bvh: Bvh,
    xyz: Tensor,
    features: Tensor,
    opacity: Tensor,
    sigma: Tensor,
    origins: Tensor,
    directions: Tensor,
    *,
    camera: Camera | None = None,
    t_min: float = 0.01,
    layers: int | None = None,
    backend: str = "auto",
    threads: int = 0,
) -> RaySplats:
    """Composite soft triangles front to back along rays, as UTrice does (Li et al. 2025). The opacity decreases from
    the incentre of a triangle to its edges by the window function of triangle splatting (Held et al. 2025).

    Let b_k be the barycentric coordinate of vertex k at the hit, P the triangle's perimeter, l_k the length of the edge
    opposite to vertex k, and a_k = b_k * P / l_k. The window function is min(a_0, a_1, a_2)^sigma, which is 1 at the
    incentre and 0 at the edges. The triangle's alpha is min(0.99, opacity * window). Triangles with an alpha of at
    least 1/255 are composited in ascending order of the ray parameter t of their hits, until the transmittance is at
    most 1e-4. At equal t, the triangle with the smaller index comes first.

    Edge lengths and barycentric coordinates are those of the triangle projected to the image of ``camera``, or those of
    the triangle in 3D if ``camera`` is None. If ``camera`` is given, rays through its pixel centres give the image of
    :func:`fourd.rendering.triangles.splat_triangles`, but with triangles sorted by t, not by their centres' depths.

    Args:
        bvh: bounding volume hierarchy of the triangles.
        xyz: (V, 3) float32 positions, equal to ``bvh.xyz``.
        features: (T, C) float32 colours or other features.
        opacity: (T,) float32 opacity at the incentre.
        sigma: (T,) float32 exponent of the window function, positive.
        camera: camera whose image defines the window function, or None to define it in 3D.
        t_min: hits with t below ``t_min`` are skipped. The point at t is ``origin + t * direction``.
        layers: maximum number of triangles that are composited along a ray, or None for no limit.

    The other arguments are those of :func:`fourd.rendering.rays.trace`.
    The results are differentiable in ``xyz``, ``features``, ``opacity``, ``sigma``, ``origins`` and ``directions``.

    Raises:
        TypeError, ValueError: for an invalid argument. The message names the argument and the expected value.
    """
    count = len(bvh.triangles)
    check_tensor("features", features, (count, "C"), like=("xyz", xyz))
    for name, value in (("opacity", opacity), ("sigma", sigma)):
        check_tensor(name, value, (count,), like=("xyz", xyz))
    limit = check_layers(layers)
    next_hits = partial(trace, bvh, xyz, t_min=t_min, layers=CHUNK_LAYERS, backend=backend, threads=threads)
    soup = _Soup(features, opacity, sigma, _Window(xyz[bvh.triangles.long()], camera))
    state = _State.start(features, len(origins))
    active = torch.arange(len(origins), device=origins.device)
    after: tuple[Tensor, Tensor] | None = None
    while len(active) > 0:
        hits = next_hits(origins[active], directions[active], after=after)
        more = hits.is_hit[:, -1] & ~state.composite(soup, hits, active, limit)
        t, triangle = hits.last()
        after, active = (t[more], triangle[more]), active[more]
    return RaySplats(state.colour, 1 - state.transmittance)


class _Window:
    """Computes min(a_0, a_1, a_2) from the hits' barycentric coordinates. The window function of
    :func:`splat_along_rays` is this number to the power sigma. The triangle is projected to the image of ``camera``, or
    used in 3D if ``camera`` is None."""

    def __init__(self, corners: Tensor, camera: Camera | None) -> None:
        if camera is None:
            self.depths = None
            edges = corners[:, [2, 0, 1]] - corners[:, [1, 2, 0]]
            length = edges.square().sum(-1).sqrt()
        else:
            flat = corners.reshape(-1, 3)
            index = torch.arange(len(flat), dtype=torch.int32, device=flat.device).reshape(-1, 3)
            u, v, self.depths = project_corners(flat, index, camera).unbind(-1)
            length = edges_of(u, v)[2]
        self.scale = length.sum(1, keepdim=True) / length

    def at(self, triangle: Tensor, weights: Tensor) -> Tensor:
        """Return the number min(a_0, a_1, a_2) of each of M hits as a tensor (M,), given the hits' triangle indices
        (M,) and their barycentric coordinates (M, 3) in the 3D triangles."""
        if self.depths is not None:
            # Barycentric coordinates in the image are proportional to those in 3D multiplied by the vertices' depths.
            scaled = weights * self.depths[triangle]
            weights = scaled / scaled.sum(1, keepdim=True)
        return (weights * self.scale[triangle]).amin(1)


def _alpha(window: Tensor, opacity: Tensor, sigma: Tensor) -> Tensor:
    is_inside = window >= SMALLEST_WINDOW
    safe = torch.where(is_inside, window, torch.ones_like(window))
    value = opacity * torch.exp2(sigma * torch.log2(safe))
    # Alphas that are clamped to MAX_ALPHA have no gradient.
    limited = torch.where(value <= MAX_ALPHA, value, torch.full_like(value, MAX_ALPHA))
    return torch.where(is_inside & (value >= MIN_ALPHA), limited, torch.zeros_like(value))


@dataclass(frozen=True)
class _Soup:
    """The triangles' features (T, C), opacity (T,) and sigma (T,), and ``window``, which computes the number min(a_0,
    a_1, a_2) of a hit (see :func:`splat_along_rays`)."""

    features: Tensor
    opacity: Tensor
    sigma: Tensor
    window: _Window

    def alpha(self, hits: Hits, ray: Tensor, layer: Tensor) -> Tensor:
        """Return the alpha (M,) of M hits."""
        triangle = hits.triangle[ray, layer].long()
        weights = torch.stack([hits.u[ray, layer], hits.v[ray, layer]], 1)
        window = self.window.at(triangle, torch.cat([weights, 1 - weights.sum(1, keepdim=True)], 1))
        return _alpha(window, self.opacity[triangle], self.sigma[triangle])


@dataclass
class _State:
    """The compositing state of R rays.

    Attributes:
        colour: (R, C) features composited so far.
        transmittance: (R,) transmittance behind the last composited triangle.
        taken: (R,) int64 number of triangles composited so far.
    """

    colour: Tensor
    transmittance: Tensor
    taken: Tensor

    @staticmethod
    def start(features: Tensor, rays: int) -> _State:
        return _State(
            features.new_zeros(rays, features.shape[1]),
            features.new_ones(rays),
            torch.zeros(rays, dtype=torch.int64, device=features.device),
        )

    def composite(self, soup: _Soup, hits: Hits, active: Tensor, limit: int) -> Tensor:
        """Composite the next hits of the rays with the indices ``active`` (A,). Return a mask (A,), which is true for
        the rays whose compositing is complete."""
        ray, layer = hits.is_hit.nonzero(as_tuple=True)
        alpha = soup.features.new_zeros(hits.t.shape).index_put((ray, layer), soup.alpha(hits, ray, layer))
        counts = (alpha.detach() > 0).long()
        before = self.taken[active, None] + torch.cumsum(counts, 1) - counts
        alpha = torch.where(before < limit, alpha, torch.zeros_like(alpha))
        products = torch.cumprod(1 - alpha, 1)
        transmittance = self.transmittance[active]
        in_front = transmittance[:, None] * torch.cat([torch.ones_like(products[:, :1]), products[:, :-1]], 1)
        is_behind = in_front.detach() <= MIN_TRANSMITTANCE
        weights = torch.where(is_behind, torch.zeros_like(alpha), in_front * alpha)
        triangle = hits.triangle[ray, layer].long()
        colour = weights[ray, layer, None] * soup.features[triangle]
        self.colour = self.colour.index_add(0, active[ray], colour)
        # The new transmittance is the old transmittance minus the sum of the weights. Multiplying the old transmittance
        # by ``products[:, -1]`` would be wrong, because this product includes the alphas of hits behind the last
        # composited triangle.
        remaining = transmittance - weights.sum(1)
        self.transmittance = self.transmittance.index_put((active,), remaining)
        self.taken[active] += ((alpha.detach() > 0) & ~is_behind).sum(1)
        return (remaining.detach() <= MIN_TRANSMITTANCE) | (self.taken[active] >= limit)
