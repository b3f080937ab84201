"""Gradients at visibility edges without antialiasing (public API)."""

from __future__ import annotations

from torch import Tensor

from fourd.ops.antialias.topology import opposite_vertices
from fourd.ops.edge_gradients.op import add_edge_gradients
from fourd.ops.edge_gradients.reference import add_edge_gradients_reference
from fourd.ops.meshes.backends import Backend
from fourd.raster.triangles.antialiasing import Topology, check_antialias


def edge_gradients(
    color: Tensor,
    rast: Tensor,
    pos: Tensor,
    tri: Tensor,
    topology: Topology | None = None,
    *,
    backend: Backend = "auto",
    threads: int = 0,
) -> Tensor:
    """Return ``color`` unchanged. The backward pass adds a term to the gradient of ``pos``: the gradient that the
    motion of visibility edges causes.

    Unlike ``antialias``, this function gives gradients at visibility edges without changing the image. The method
    follows Pidhorskyi et al. 2024, "Rasterized edge gradients". A visibility edge separates two neighbouring pixels
    that show different triangles. Let c_1 and c_2 be the colours of the two pixels. If the edge moves by dt pixels from
    the first pixel towards the second, one of the two pixels changes by dt * (c_1 - c_2). Because it is not known which
    of the two pixels changes, the gradient is the mean of the gradients of both cases. A visibility edge is one of two
    kinds: a silhouette edge of the nearer triangle, as in :func:`fourd.raster.triangles.antialias`, or the line along
    which two triangles intersect. Edges whose angle to the segment between the pixel centres is below 45 degrees are
    ignored.

    The result is differentiable in ``color`` and in x, y and w of ``pos``. The gradient of the result is passed to
    ``color`` unchanged. At intersections, the result is also differentiable in z. The forward pass copies no data, and
    the edges are found in the backward pass. On the CPU, gradients are bit-identical for any number of threads. On a
    GPU, the last bits of the gradient of ``pos`` can differ between calls.

    Args:
        color, rast, pos, tri, topology, backend, threads: see :func:`fourd.raster.triangles.antialias`.

    Returns:
        (B, H, W, C) the values of ``color``, in the same memory.

    Raises:
        TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
        RuntimeError: if the backend was not built.
    """
    chosen = check_antialias(color, rast, pos, tri, topology, 1.0, backend)
    opposite = opposite_vertices(tri) if topology is None else topology.opposite
    if chosen == "reference":
        return add_edge_gradients_reference(color, rast, pos, tri, opposite)
    return add_edge_gradients(color, rast.detach(), pos, tri, opposite, threads)
