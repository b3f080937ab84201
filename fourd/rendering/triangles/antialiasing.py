"""Antialiasing of silhouette edges (public API)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from fourd.rendering.ops.antialias import op
from fourd.rendering.ops.antialias.reference import antialias_reference
from fourd.rendering.ops.antialias.topology import opposite_vertices
from fourd.rendering.ops.meshes.backends import Backend, select_backend
from fourd.rendering.ops.meshes.checks import check_resolution, check_tensor, check_triangles


@dataclass(frozen=True)
class Topology:
    """The neighbours of a mesh's triangles, for :func:`antialias`.

    Attributes:
        opposite: (T, 3) int32. Element (t, i) describes the edge of triangle t that is opposite to its vertex i. It is
            the index of the vertex that lies opposite to this edge in the triangle on the edge's other side, or -1 if
            there is no such triangle. Edges with the value -1 are always silhouette edges.
    """

    opposite: Tensor


def antialias_construct_topology(tri: Tensor) -> Topology:
    """Find the neighbours of all triangles. Use the result to speed up several calls of :func:`antialias` with the same
    triangles.

    Args:
        tri: (T, 3) int32 vertex indices. Triangles are neighbours if they share two vertex indices, regardless of
            orientation.

    Raises:
        TypeError, ValueError: for an invalid ``tri``. The error message names the expected value.
    """
    check_triangles(tri, 2**31 - 1, ("tri", tri))
    return Topology(opposite_vertices(tri))


def antialias(
    color: Tensor,
    rast: Tensor,
    pos: Tensor,
    tri: Tensor,
    topology: Topology | None = None,
    pos_gradient_boost: float = 1.0,
    *,
    backend: Backend = "auto",
    threads: int = 0,
) -> Tensor:
    """Blend pixels across silhouette edges (Laine et al. 2020, "Modular primitives for high-performance differentiable
    rendering", section 3.5).

    Each pixel is compared with its right and its lower neighbour. Let p and q be two neighbouring pixels that show
    different triangles, p the one with the smaller z/w, and let c_p and c_q be their colours. Pixels are blended if a
    silhouette edge of p's triangle crosses the segment between the centres of p and q. Let t be the distance in pixels
    from the centre of p to the crossing. If t < 0.5, c_p changes by (0.5 - t) * (c_q - c_p). If t >= 0.5, c_q changes
    by (t - 0.5) * (c_p - c_q). Edges whose angle to the segment is below 45 degrees are ignored.

    An edge is a silhouette edge of a triangle if the triangle has no neighbour across it, or if this neighbour lies on
    the same side of the edge in the image. As in nvdiffrast, an edge has up to two sides, each with one opposite
    vertex: the first two different ones in the order of ``tri``. Duplicated and double-sided faces therefore count as
    one. If three or more faces with different vertices meet in an edge, the edge is a silhouette edge of the third and
    later ones.

    The result is differentiable in ``color`` and, through t, in x, y and w of ``pos``. On the CPU, results and
    gradients are bit-identical for any number of threads. On a GPU, the last bits of the gradient of ``pos`` can differ
    between calls.

    Args:
        color: (B, H, W, C) image to antialias. The values are not checked.
        rast: (B, H, W, 4) result of ``rasterize`` for ``pos`` and ``tri``. Pixels with triangle indices of T or more
            are treated as background.
        pos: (B, V, 4) vertices in clip space, or (V, 4) if all images share the vertices ("range mode"). Pixels are not
            blended across an edge if one of its vertices has a non-finite coordinate.
        tri: (T, 3) int32 vertex indices. On the CPU, an index out of range is an error; on a GPU, its triangle is
            ignored.
        topology: result of :func:`antialias_construct_topology` for ``tri``, or None to compute it in this call.
        pos_gradient_boost: factor for the gradient of ``pos``.
        backend: "reference" for an implementation in plain torch (slow, float32 or float64), "cpu" or "cuda" for the
            float32 kernels, or "auto" for the kernels for the tensors' device.
        threads: number of CPU threads. 0 means the environment variable FOURD_THREADS, or torch.get_num_threads().

    Returns:
        (B, H, W, C) antialiased image.

    Raises:
        TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
        RuntimeError: if the backend was not built.
    """
    chosen = check_antialias(color, rast, pos, tri, topology, pos_gradient_boost, backend)
    opposite = opposite_vertices(tri, pos.shape[-2]) if topology is None else topology.opposite
    if chosen == "reference":
        return antialias_reference(color, rast, pos, tri, opposite, pos_gradient_boost)
    return op.antialias(color, rast.detach(), pos, tri, opposite, float(pos_gradient_boost), threads)[0]


def check_antialias(
    color: Tensor,
    rast: Tensor,
    pos: Tensor,
    tri: Tensor,
    topology: Topology | None,
    pos_gradient_boost: float,
    backend: str,
) -> str:
    """Check the arguments and select the backend."""
    if not isinstance(color, Tensor) or color.ndim != 4 or not color.dtype.is_floating_point:
        check_tensor("color", color, ("B", "H", "W", "C"))
    chosen = select_backend(backend, "color", color)
    batch, height, width, _ = color.shape
    check_resolution((height, width))
    like = ("color", color)
    check_tensor("rast", rast, (batch, height, width, 4), like=like)
    if isinstance(pos, Tensor) and pos.ndim == 2:
        check_tensor("pos", pos, ("V", 4), like=like)
    else:
        check_tensor("pos", pos, (batch, "V", 4), like=like)
    check_triangles(tri, pos.shape[-2], like, check_values=color.device.type == "cpu")
    if topology is not None:
        if not isinstance(topology, Topology):
            found = type(topology).__name__
            raise TypeError(f"topology: expected a result of antialias_construct_topology or None, got {found}")
        check_tensor("topology.opposite", topology.opposite, ("T", 3), like=("tri", tri), dtypes=(torch.int32,))
        if topology.opposite.shape[0] != tri.shape[0]:
            expected = f"the topology of the {tri.shape[0]} triangles of tri"
            raise ValueError(f"topology: expected {expected}, got one of {topology.opposite.shape[0]} triangles")
    if not math.isfinite(pos_gradient_boost):
        raise ValueError(f"pos_gradient_boost: expected a finite number, got {pos_gradient_boost}")
    return chosen
