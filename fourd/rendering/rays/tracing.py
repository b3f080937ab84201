"""Ray tracing of triangle meshes: :func:`trace`, :func:`occluded` and :func:`visibility`."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from fourd.rendering.ops.meshes.checks import check_tensor
from fourd.rendering.ops.rays.op import occluded_rays, trace_rays
from fourd.rendering.ops.rays.reference import trace_rays_reference
from fourd.rendering.rays.bvh import Bvh

MAX_LAYERS = 1024
MAX_RAYS = 2**31 - 1


@dataclass(frozen=True)
class Hits:
    """The K nearest hits of R rays, sorted by t, and by triangle index at equal t.

    Attributes:
        t: (R, K) float32, differentiable; infinite where there is no hit. The hit is at ``origin + t * direction``.
        u, v: (R, K) float32 barycentric coordinates of the triangle's vertices 0 and 1, differentiable; 0 where there
            is no hit. That of vertex 2 is 1 - u - v.
        triangle: (R, K) int32 triangle index; -1 where there is no hit.
    """

    t: Tensor
    u: Tensor
    v: Tensor
    triangle: Tensor

    @property
    def is_hit(self) -> Tensor:
        """(R, K) bool mask, true where there is a hit."""
        return self.triangle >= 0

    def last(self) -> tuple[Tensor, Tensor]:
        """Return the t and the triangle index of each ray's K-th hit, as two tensors (R,). Pass them to :func:`trace`
        as ``after`` to find the next hits of each ray. For rays with fewer than K hits, it finds no further hits."""
        return self.t[:, -1].detach(), self.triangle[:, -1]


def trace(
    bvh: Bvh,
    xyz: Tensor,
    origins: Tensor,
    directions: Tensor,
    *,
    t_min: float | Tensor = 0.0,
    t_max: float | Tensor = torch.inf,
    layers: int = 1,
    after: tuple[Tensor, Tensor] | None = None,
    backend: str = "auto",
    threads: int = 0,
) -> Hits:
    """Find the nearest hits of rays with triangles.

    The result is the same as if each ray were tested against every triangle. Hits are sorted by t, and by triangle
    index at equal t. The test is watertight (Woop, Benthin and Wald 2013): a ray through the common edge of two
    triangles hits at least one of them. Rays hit triangles from both sides. Triangles with two equal corners, and those
    seen exactly edge-on, are never hit.

    Args:
        bvh: bounding volume hierarchy of the triangles.
        xyz: (V, 3) float32 positions in world units, equal to ``bvh.xyz``. The gradient of the positions flows to this
            tensor, because ``bvh.xyz`` is detached.
        origins: (R, 3) float32 in world units, with absolute values of at most 1e18.
        directions: (R, 3) float32, of any length. The point at t is ``origin + t * direction``. The largest absolute
            coordinate of a direction must be between 1e-18 and 1e18. A ray whose origin or direction is out of range
            hits nothing.
        t_min: lower limit of the range of t in which hits are found: a number for all rays, or a tensor (R,) with one
            number per ray.
        t_max: upper limit of this range, likewise. A ray with t_min > t_max hits nothing.
        layers: maximum number K of hits per ray, from 1 to 1024.
        after: t (R,) and triangle (R,) of one hit per ray. Only hits that come after it are found. Pass ``hits.last()``
            of the previous call to get the next hits. Hits of equal t are then neither lost nor repeated.
        backend: "auto" for the kernels for the tensors' device, or "reference" for plain torch (float32 or float64,
            slow).
        threads: number of threads on the CPU; 0 means the environment variable FOURD_THREADS, or
            torch.get_num_threads(). Results are bit-identical for any number of threads and any instruction set.

    Returns:
        The hits. t, u and v are differentiable in ``xyz``, ``origins`` and ``directions``, by implicit differentiation
        of the equation of Moeller and Trumbore (1997). On a GPU, the last bits of the gradient of ``xyz`` can differ
        between calls.

    Raises:
        TypeError, ValueError: for an invalid argument. The message names the argument and the expected value.
    """
    low, high = _check_rays(bvh, origins, directions, t_min, t_max, threads, backend)
    after_t, after_triangle = _check_trace(bvh, xyz, origins, layers, after)
    rays = (xyz, bvh.triangles, origins, directions, low, high, after_t, after_triangle, layers)
    if backend == "reference":
        return Hits(*trace_rays_reference(*rays))
    return Hits(*trace_rays(bvh.nodes, bvh.blocks, bvh.magnitude, *rays, threads))


def occluded(
    bvh: Bvh,
    origins: Tensor,
    directions: Tensor,
    *,
    t_min: float | Tensor = 0.0,
    t_max: float | Tensor = torch.inf,
    threads: int = 0,
) -> Tensor:
    """Return a mask (R,) of the rays that hit any triangle with t in [t_min, t_max].

    For the arguments, see :func:`trace`. The result is not differentiable.

    Raises:
        TypeError, ValueError: for an invalid argument. The message names the argument and the expected value.
    """
    low, high = _check_rays(bvh, origins, directions, t_min, t_max, threads, "auto")
    return occluded_rays(bvh.nodes, bvh.blocks, bvh.magnitude, origins, directions, low, high, threads)


def visibility(bvh: Bvh, points: Tensor, targets: Tensor, *, margin: float = 1e-4, threads: int = 0) -> Tensor:
    """Return a mask (N, M) whose element (i, j) is true if no triangle lies between point i and target j.

    Args:
        bvh: bounding volume hierarchy of the triangles.
        points: (N, 3) float32 in world units.
        targets: (M, 3) float32 in world units, for example camera centres.
        margin: fraction of the distance between a point and a target, at least 0 and below 0.5. Intersections closer
            than this to the point or to the target are ignored, so that a surface does not occlude its own points.
        threads: as in :func:`trace`.

    Raises:
        TypeError, ValueError: for an invalid argument. The message names the argument and the expected value.
    """
    check_tensor("points", points, ("N", 3), like=("bvh.xyz", bvh.xyz))
    check_tensor("targets", targets, ("M", 3), like=("bvh.xyz", bvh.xyz))
    if not 0 <= margin < 0.5:
        raise ValueError(f"margin: expected a share from 0 to 0.5, got {margin}")
    shape = (len(points), len(targets), 3)
    origins = points.detach()[:, None].expand(shape).reshape(-1, 3).contiguous()
    directions = (targets.detach()[None] - points.detach()[:, None]).reshape(-1, 3).contiguous()
    is_occluded = occluded(bvh, origins, directions, t_min=margin, t_max=1 - margin, threads=threads)
    return ~is_occluded.reshape(shape[:2])


def _check_rays(
    bvh: Bvh,
    origins: Tensor,
    directions: Tensor,
    t_min: float | Tensor,
    t_max: float | Tensor,
    threads: int,
    backend: str,
) -> tuple[Tensor, Tensor]:
    """Check the rays, and return t_min and t_max as tensors with one element for all rays, or one per ray."""
    if backend not in ("auto", "reference"):
        raise ValueError(f"backend: expected 'auto' or 'reference', got {backend!r}")
    if threads < 0:
        raise ValueError(f"threads: expected 0 (for the default) or more, got {threads}")
    dtypes = (torch.float32, torch.float64) if backend == "reference" else (torch.float32,)
    check_tensor("origins", origins, ("R", 3), dtypes=dtypes)
    if len(origins) > MAX_RAYS:
        raise ValueError(f"origins: expected at most {MAX_RAYS} rays, got {len(origins)}; trace them in several calls")
    check_tensor("directions", directions, ("R", 3), like=("origins", origins))
    if origins.device != bvh.xyz.device:
        raise ValueError(f"origins: expected device {bvh.xyz.device}, that of the tree, got {origins.device}")
    if len(directions) != len(origins):
        raise ValueError(f"directions: expected {len(origins)} rays, as in origins, got {len(directions)}")
    low, high = (_limit(name, value, origins) for name, value in (("t_min", t_min), ("t_max", t_max)))
    of_all_rays = not isinstance(t_min, Tensor) and not isinstance(t_max, Tensor)
    if of_all_rays and not bool(low[0] <= high[0]):
        raise ValueError(f"t_min: expected at most t_max, got {float(low[0])} and {float(high[0])}")
    return low, high


def _check_trace(
    bvh: Bvh, xyz: Tensor, origins: Tensor, layers: int, after: tuple[Tensor, Tensor] | None
) -> tuple[Tensor | None, Tensor | None]:
    """Check the arguments that only :func:`trace` has. Return the two tensors of ``after``, which are t and the
    triangle index of one hit per ray, or (None, None) if ``after`` is None."""
    like = ("origins", origins)
    check_tensor("xyz", xyz, ("V", 3), like=like)
    bvh.require_positions(xyz)
    if isinstance(layers, bool) or not isinstance(layers, int):
        raise TypeError(f"layers: expected an integer, got {type(layers).__name__}")
    if not 1 <= layers <= MAX_LAYERS:
        raise ValueError(f"layers: expected 1 to {MAX_LAYERS}, got {layers}")
    if after is None:
        return None, None
    after_t = check_tensor("after[0]", after[0], (len(origins),), like=like).detach()
    return after_t, check_tensor("after[1]", after[1], (len(origins),), dtypes=(torch.int32,))


def _limit(name: str, value: float | Tensor, origins: Tensor) -> Tensor:
    if isinstance(value, Tensor):
        return check_tensor(name, value, (len(origins),), like=("origins", origins)).detach()
    if value != value:
        raise ValueError(f"{name}: expected a number, got NaN")
    return torch.tensor([value], dtype=origins.dtype, device=origins.device)
