"""Rasterization of triangles: the operator ``torch.ops.fourd.rasterize_triangles`` and its gradient.

The public API, which checks the arguments and selects the backend, is :mod:`fourd.rendering.triangles.rasterization`.
The operators support autograd, ``torch.library.opcheck`` and, through fake implementations, ``torch.compile``.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import uses_gpu_kernels
from fourd.rendering.ops.loading import as_array, load_native, simd_name, thread_count
from fourd.rendering.ops.operator import operator
from fourd.rendering.ops.rasterize import cuda as gpu


@operator(
    "fourd::rasterize_triangles",
    outputs=lambda pos, ranges, height, width, output_db: _empty_images(pos, ranges, height, width, output_db),
)
def rasterize_triangles(
    pos: Tensor,
    tri: Tensor,
    ranges: Tensor | None,
    previous: Tensor | None,
    height: int,
    width: int,
    output_db: bool,
    grad_db: bool,
    threads: int,
) -> tuple[Tensor, Tensor]:
    """Rasterize triangles. Return ``rast`` (B, H, W, 4), and ``rast_db`` of the same shape, or (B, H, W, 0) if
    ``output_db`` is False.

    The vertices ``pos`` are (B, V, 4), or (1, V, 4) if ``ranges`` is given. ``ranges`` (B, 2) is a CPU tensor with the
    first triangle and the number of triangles of each image. ``previous`` is the ``rast`` of the previous depth layer.
    """
    rast, rast_db = _empty_images(pos, ranges, height, width, output_db)
    inputs = (pos, tri, ranges, previous)
    if uses_gpu_kernels(pos):
        gpu.rasterize(*inputs, rast, rast_db if output_db else None)
        return rast, rast_db
    load_native().rasterize_triangles(
        *(None if tensor is None else as_array(tensor) for tensor in inputs),
        thread_count(threads, torch.get_num_threads()),
        simd_name(),
        rast.numpy(),
        rast_db.numpy() if output_db else None,
    )
    return rast, rast_db


@operator(
    "fourd::rasterize_triangles_backward",
    outputs=lambda pos: torch.empty_like(pos, memory_format=torch.contiguous_format),
)
def rasterize_triangles_backward(
    pos: Tensor,
    tri: Tensor,
    ranges: Tensor | None,
    rast: Tensor,
    grad_rast: Tensor,
    grad_rast_db: Tensor | None,
    threads: int,
) -> Tensor:
    """Compute the gradient of ``pos`` from the gradients of ``rast`` and ``rast_db``."""
    grad_pos = torch.empty_like(pos, memory_format=torch.contiguous_format)
    if uses_gpu_kernels(pos):
        gpu.rasterize_backward(pos, tri, ranges, rast, grad_rast, grad_rast_db, grad_pos)
        return grad_pos
    load_native().rasterize_triangles_backward(
        as_array(pos),
        as_array(tri),
        None if ranges is None else as_array(ranges),
        as_array(rast),
        thread_count(threads, torch.get_num_threads()),
        simd_name(),
        as_array(grad_rast),
        None if grad_rast_db is None else as_array(grad_rast_db),
        grad_pos.numpy(),
    )
    return grad_pos


def _setup(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
    pos, tri, ranges, _previous, _height, _width, output_db, grad_db, ctx.threads = inputs
    ctx.has_db_gradient = output_db and grad_db
    ctx.set_materialize_grads(False)
    ctx.save_for_backward(pos, tri, ranges, output[0])


def _backward(ctx: Any, grad_rast: Tensor | None, grad_rast_db: Tensor | None) -> tuple[Tensor | None, ...]:
    pos, tri, ranges, rast = ctx.saved_tensors
    if not ctx.has_db_gradient:
        grad_rast_db = None
    grad_pos = None
    if grad_rast is not None or grad_rast_db is not None:
        grad_rast = torch.zeros_like(rast) if grad_rast is None else grad_rast
        grad_pos = rasterize_triangles_backward(pos, tri, ranges, rast, grad_rast, grad_rast_db, ctx.threads)
    tri = ranges = previous = height = width = output_db = grad_db = threads = None
    return grad_pos, tri, ranges, previous, height, width, output_db, grad_db, threads


rasterize_triangles.register_autograd(_backward, setup_context=_setup)


def _empty_images(
    pos: Tensor, ranges: Tensor | None, height: int, width: int, output_db: bool
) -> tuple[Tensor, Tensor]:
    images = pos.shape[0] if ranges is None else ranges.shape[0]
    return (
        pos.new_empty(images, height, width, 4),
        pos.new_empty(images, height, width, 4 if output_db else 0),
    )
