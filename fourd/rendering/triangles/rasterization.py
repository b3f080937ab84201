"""Rasterization of triangles: :func:`rasterize`."""

from __future__ import annotations

import torch
from torch import Tensor

from fourd.rendering.ops.meshes.backends import select_backend
from fourd.rendering.ops.meshes.checks import check_resolution, check_tensor, check_triangles
from fourd.rendering.ops.rasterize.op import rasterize_triangles
from fourd.rendering.ops.rasterize.reference import rasterize_triangles_reference


def rasterize(
    pos: Tensor,
    tri: Tensor,
    resolution: tuple[int, int],
    *,
    ranges: Tensor | None = None,
    grad_db: bool = True,
    output_db: bool = True,
    backend: str = "auto",
    threads: int = 0,
) -> tuple[Tensor, Tensor]:
    """Find the nearest triangle at every pixel, and the barycentric coordinates of the pixel centre in this triangle.

    The semantics are the same as in nvdiffrast (Laine et al. 2020, Modular Primitives for High-Performance
    Differentiable Rendering). A vertex with clip coordinates (x, y, z, w) is at the image position (x/w, y/w). The
    centre of the pixel in row i and column j is at ((2 * j + 1) / W - 1, (2 * i + 1) / H - 1), so row 0 is at the image
    border y = -1. A triangle is visible where z/w is in [-1, 1]. A pixel shows the triangle with the smallest z/w. If
    several triangles have this z/w, the pixel shows the one with the smallest index. Back faces are also visible.

    Vertex positions are rounded to 1/256 pixel, so that the coverage test is exact in integer arithmetic. If a pixel
    centre lies on the common edge of two triangles, exactly one of them covers the pixel. If a vertex is behind the
    camera (w <= 0), the part of the triangle in front of the camera is drawn. Triangles with a NaN or infinite vertex
    are culled.

    Args:
        pos: float32 clip coordinates: (B, V, 4) with one mesh per image, or (V, 4) if ``ranges`` is given.
        tri: (T, 3) int32 vertex indices, which all images share.
        resolution: (H, W) in pixels, each from 1 to 32768.
        ranges: (B, 2) int32, on any device. Row b has the index of the first triangle of image b, and the number of
            triangles of image b.
        grad_db: whether the gradient with respect to ``pos`` includes the gradient through ``rast_db``.
        output_db: whether to compute ``rast_db``. If False, ``rast_db`` has the shape (B, H, W, 0).
        backend: "cpu" or "cuda" for the kernels, "reference" for an implementation in plain torch (float32 or float64,
            slow), or "auto" for the kernels for the tensors' device.
        threads: number of threads on the CPU; 0 means the environment variable FOURD_THREADS, or
            torch.get_num_threads() if it is not set. Results are bit-identical for any number of threads.

    Returns:
        ``rast`` (B, H, W, 4) and ``rast_db`` (B, H, W, 4). The channels of ``rast`` are u, v, z/w and an encoded
        triangle index. u, v and 1 - u - v are the perspective-correct barycentric coordinates of the triangle's
        vertices 0, 1 and 2, with u and v clamped to the triangle. The encoded index is 0 if there is no triangle, and
        the triangle's index + 1 otherwise. Decode indices of 2^24 and above with
        :func:`fourd.rendering.ops.meshes.ids.decode_ids`. The channels of ``rast_db`` are du/dX, du/dY, dv/dX and
        dv/dY, where (X, Y) is the pixel position: X increases with the column, and Y with the row. Pixels without a
        triangle have the value 0.

        u, v and ``rast_db`` are differentiable in ``pos``; z/w and the index have no gradient. Second derivatives are
        not supported. The gradient is 0 in pixels where clamping changes u or v. On a GPU, its last bits can differ
        between calls.

    Raises:
        TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
        RuntimeError: if ``backend`` needs CUDA kernels that were not built.
    """
    positions, tri, ranges = check_mesh(pos, tri, ranges)
    height, width = check_resolution(resolution)
    if select_backend(backend, "pos", pos) == "reference":
        return rasterize_triangles_reference(positions, tri, ranges, None, height, width, output_db, grad_db)
    return rasterize_triangles(positions, tri, ranges, None, height, width, output_db, grad_db, threads)


def check_mesh(pos: object, tri: object, ranges: Tensor | None) -> tuple[Tensor, Tensor, Tensor | None]:
    """Check the arguments that describe a mesh.

    Returns:
        ``pos`` as (B, V, 4), or as (1, V, 4) if ``ranges`` is given; ``tri``; and ``ranges`` on the CPU.

    Raises:
        TypeError, ValueError: with a message that names the argument.
    """
    shape: tuple[int | str, ...] = ("V", 4) if ranges is not None else ("B", "V", 4)
    positions = check_tensor("pos", pos, shape, dtypes=(torch.float32, torch.float64))
    # On a GPU, indices are not checked here, because the check would have to wait for the GPU. The kernel skips
    # triangles with an index out of range.
    on_cpu = positions.device.type == "cpu"
    triangles = check_triangles(tri, positions.shape[-2], ("pos", positions), check_values=on_cpu)
    if ranges is None:
        return positions, triangles, None
    check_tensor("ranges", ranges, ("B", 2), dtypes=(torch.int32,))
    ranges = ranges.cpu()
    for first, count in ranges.tolist():
        if first < 0 or count < 0 or first + count > triangles.shape[0]:
            raise ValueError(
                f"ranges: expected first triangles and counts within the {triangles.shape[0]} triangles of tri, "
                f"got ({first}, {count})"
            )
    return positions[None], triangles, ranges
