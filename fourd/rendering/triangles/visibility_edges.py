"""Gradients at visibility edges without antialiasing (public API)."""

from __future__ import annotations

from torch import Tensor

from fourd.rendering.ops.antialias.topology import opposite_vertices
from fourd.rendering.ops.edge_gradients.op import add_edge_gradients
from fourd.rendering.ops.edge_gradients.reference import add_edge_gradients_reference
from fourd.rendering.ops.meshes.backends import Backend
from fourd.rendering.triangles.antialiasing import Topology, check_antialias


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
    """Return ``color`` unchanged. The backward pass adds the effect of moving visibility edges to the gradient of
    ``pos``.

    Unlike ``antialias``, this function gives gradients at visibility edges without changing the image (Pidhorskyi et
    al. 2024, "Rasterized edge gradients"). A visibility edge separates two neighbouring pixels that show different
    triangles. It is either a silhouette edge of the nearer triangle, as in :func:`fourd.rendering.triangles.antialias`,
    or the line along which the two triangles intersect. Edges whose angle to the segment between the pixel centres is
    below 45 degrees are ignored.

    Let c_1 and c_2 be the colours of the two pixels. If the edge moves by dt pixels from the first pixel towards the
    second, the pixel that contains the edge changes by dt * (c_1 - c_2). The edge can be in either of the two pixels,
    so the gradient is the mean of the gradients for these two cases.

    The result is differentiable in ``color`` and ``pos``. The gradient of ``color`` is the gradient of the result,
    unchanged. Silhouette edges give gradients of x, y and w of ``pos``, and intersections also give gradients of z. The
    forward pass copies no data; the backward pass finds the edges. On the CPU, gradients are bit-identical for any
    number of threads. On a GPU, the last bits of the gradient of ``pos`` can differ between calls.

    The arguments are those of :func:`fourd.rendering.triangles.antialias`.

    Returns:
        The values of ``color`` (B, H, W, C), in the same memory.

    Raises:
        TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
        RuntimeError: if the backend was not built.
    """
    chosen = check_antialias(color, rast, pos, tri, topology, 1.0, backend)
    opposite = opposite_vertices(tri, pos.shape[-2]) if topology is None else topology.opposite
    if chosen == "reference":
        return add_edge_gradients_reference(color, rast, pos, tri, opposite)
    return add_edge_gradients(color, rast.detach(), pos, tri, opposite, threads)
