"""Rasterization of triangles: :func:`rasterize`."""

from __future__ import annotations

import torch
from torch import Tensor

from fourd.ops.meshes.backends import select_backend
from fourd.ops.meshes.checks import check_resolution, check_tensor, check_triangles
from fourd.ops.rasterize.op import rasterize_triangles
from fourd.ops.rasterize.reference import rasterize_triangles_reference


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
    """Find the nearest triangle at every pixel, and the barycentric weights of the pixel's centre in this triangle.

    The semantics are the same as in nvdiffrast (Laine et al. 2020, Modular Primitives for High-Performance
    Differentiable Rendering). A vertex with clip coordinates (x, y, z, w) is at the image position (x/w, y/w). The
    centre of the pixel in row i and column j is at ((2 * j + 1) / W - 1, (2 * i + 1) / H - 1). Row 0 is therefore at
    the border y = -1 of the image. A triangle is visible where z/w is in [-1, 1]. A pixel shows the triangle with the
    smallest z/w. If several triangles have this z/w, the pixel shows the one with the smallest index. Back faces are
    also visible.

    The positions of vertices are rounded to 1/256 pixel, so integer arithmetic makes the coverage test exact. If a
    pixel centre lies on the common edge of two triangles, exactly one of the two triangles covers the pixel. If a
    vertex of a triangle is behind the camera (w <= 0), the part of the triangle in front of the camera is drawn.
    Triangles with a vertex that is NaN or infinite are culled.

    Args:
        pos: float32 clip coordinates: (B, V, 4) with one mesh per image, or (V, 4) if ``ranges`` is given.
        tri: (T, 3) int32 vertex indices. All images share the triangles.
        resolution: (H, W) in pixels, each from 1 to 32768.
        ranges: (B, 2) int32: index of the first triangle, and number of triangles, for each image. The tensor may be on
            any device.
        grad_db: whether the gradient with respect to ``pos`` includes the gradient through ``rast_db``.
        output_db: whether to compute ``rast_db``. If false, ``rast_db`` has the shape (B, H, W, 0).
        backend: "cpu" or "cuda" for the kernels, "reference" for an implementation in plain torch (float32 or float64,
            slow), or "auto" for the kernels of the tensors' device.
        threads: number of threads on the CPU; 0 means the environment variable FOURD_THREADS, or
            torch.get_num_threads() if it is not set. Results are bit-identical for any number of threads.

    Returns:
        ``rast`` (B, H, W, 4) and ``rast_db`` (B, H, W, 4). ``rast`` has u, v, z/w and an encoded triangle index. u, v
        and 1 - u - v are the perspective-correct weights of the vertices 0, 1 and 2 of the triangle. u and v are
        clamped to the triangle. The encoded index is 0 if there is no triangle, and the triangle's index + 1 otherwise.
        :func:`fourd.ops.meshes.ids.decode_ids` also decodes indices of 2^24 and above. ``rast_db`` has du/dX, du/dY,
        dv/dX and dv/dY, where X and Y are the pixel positions along columns and rows. Pixels without a triangle have
        the value 0.

        u, v and ``rast_db`` are differentiable in ``pos``. Second derivatives are not supported. z/w and the index have
        no gradient. In pixels where clamping changes u or v, the gradient is 0. On a GPU, the last bits of the gradient
        can differ between calls.

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
    """Check the mesh that is to be rasterized.

    Returns:
        ``pos`` as (B, V, 4), or as (1, V, 4) if ``ranges`` is given; ``tri``; and ``ranges`` on the CPU.

    Raises:
        TypeError, ValueError: with a message that names the argument.
    """
    shape: tuple[int | str, ...] = ("V", 4) if ranges is not None else ("B", "V", 4)
    positions = check_tensor("pos", pos, shape, dtypes=(torch.float32, torch.float64))
    # On a GPU, indices are not checked here, because the check would have to wait for the GPU. The kernel skips
    # triangles with a wrong index.
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
