"""Gradients at visibility edges without antialiasing (public API)."""

from __future__ import annotations

from torch import Tensor

from fourd.ops.antialias.topology import opposite_vertices
from fourd.ops.edge_gradients.op import add_edge_gradients
from fourd.raster.triangles.antialiasing import Topology, check_antialias


def edge_gradients(color: Tensor, rast: Tensor, pos: Tensor, tri: Tensor, topology: Topology | None = None) -> Tensor:
    """Return ``color``, and add to the gradient of ``pos`` how the image changes as visibility edges move.

    This is the alternative to ``antialias`` that leaves the image as it is. The idea is from Pidhorskyi et al. 2024,
    "Rasterized edge gradients". Two neighbouring pixels with the colours c_1 and c_2 that show different triangles are
    separated by an edge. If the edge moves by dt pixels from the first to the second pixel, the image changes by
    dt (c_1 - c_2) at one of the two pixels. The gradient is the mean over these two pixels. An edge is a silhouette
    edge of the nearer triangle, as in :func:`fourd.raster.triangles.antialias`, or the line in which two triangles
    intersect.

    The result is differentiable in ``color``, with the gradient of the identity, and in x, y and w of ``pos``. At
    intersections, it is also differentiable in z. The implementation is plain torch on any device.

    Args:
        color, rast, pos, tri, topology: see :func:`fourd.raster.triangles.antialias`; float32 or float64.

    Returns:
        (B, H, W, C) the values of ``color``.

    Raises:
        TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
    """
    check_antialias(color, rast, pos, tri, topology, 1.0, "reference")
    opposite = opposite_vertices(tri) if topology is None else topology.opposite
    return add_edge_gradients(color, rast, pos, tri, opposite)
