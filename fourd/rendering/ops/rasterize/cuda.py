"""Calls the CUDA kernels of ``csrc/rasterize`` with torch tensors, and allocates their scratch memory."""

from __future__ import annotations

from torch import Tensor

from fourd.rendering.ops.gpu import contiguous, load_gpu


def rasterize(
    pos: Tensor, tri: Tensor, ranges: Tensor | None, previous: Tensor | None, rast: Tensor, rast_db: Tensor | None
) -> None:
    """Write the nearest triangles to ``rast`` (B, H, W, 4), and the derivatives of their barycentric coordinates to
    ``rast_db``. ``ranges`` must be on the CPU."""
    gpu = load_gpu(pos.device)
    images, height, width, _ = rast.shape
    longest_range = tri.shape[0]
    if ranges is not None:
        longest_range = min(longest_range, int(ranges[:, 1].max())) if images > 0 else 0
        ranges = ranges.to(pos.device)
    with gpu.activate():
        workspace = gpu.allocate(gpu.kernels.rasterize_workspace_bytes(images, height, width, longest_range))
        gpu.kernels.rasterize_triangles(
            contiguous(pos),
            contiguous(tri),
            None if ranges is None else contiguous(ranges),
            None if previous is None else contiguous(previous),
            longest_range,
            workspace,
            gpu.stream,
            rast,
            rast_db,
        )


def rasterize_backward(
    pos: Tensor,
    tri: Tensor,
    ranges: Tensor | None,
    rast: Tensor,
    grad_rast: Tensor,
    grad_rast_db: Tensor | None,
    grad_pos: Tensor,
) -> None:
    """Write the gradient of ``pos`` to ``grad_pos``. ``ranges`` must be on the CPU."""
    gpu = load_gpu(pos.device)
    with gpu.activate():
        gpu.kernels.rasterize_triangles_backward(
            contiguous(pos),
            contiguous(tri),
            None if ranges is None else contiguous(ranges.to(pos.device)),
            contiguous(rast),
            gpu.stream,
            contiguous(grad_rast),
            None if grad_rast_db is None else contiguous(grad_rast_db),
            grad_pos,
        )
