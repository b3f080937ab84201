"""Gradients that arise because visibility edges move with the vertices: the operator
``torch.ops.fourd.edge_gradients``, and a function that adds these gradients in the backward pass of an image.

The public API, which checks the arguments and selects the backend, is
:mod:`fourd.rendering.triangles.visibility_edges`.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import contiguous, load_gpu, uses_gpu_kernels
from fourd.rendering.ops.loading import as_array, load_native, simd_name, thread_count
from fourd.rendering.ops.operator import operator


@operator("fourd::edge_gradients", outputs=lambda pos: torch.empty_like(pos, memory_format=torch.contiguous_format))
def edge_gradients(
    color: Tensor, rast: Tensor, pos: Tensor, tri: Tensor, opposite: Tensor, gradient: Tensor, threads: int
) -> Tensor:
    """Compute the part of the gradient of ``pos`` that arises because visibility edges move with the vertices. The
    result has the shape of ``pos``. A visibility edge separates two neighbouring pixels that show different triangles.

    ``pos`` is (B, V, 4), or (V, 4) if all images have the same vertices. ``gradient`` (B, H, W, C) is the gradient of
    the loss with respect to the image. The operator itself is not differentiable.
    """
    out = torch.empty_like(pos, memory_format=torch.contiguous_format)
    instanced = pos.ndim == 3
    inputs = (color, rast, pos if instanced else pos[None], tri, opposite)
    to_pos = out if instanced else out[None]
    if uses_gpu_kernels(color):
        gpu = load_gpu(color.device)
        with gpu.activate():
            size = gpu.kernels.edge_gradients_workspace_bytes(tri.shape[0], color.shape[0], instanced)
            workspace = (gpu.allocate(size), gpu.stream)
            gpu.kernels.edge_gradients(*map(contiguous, inputs), instanced, *workspace, contiguous(gradient), to_pos)
        return out
    count = thread_count(threads, torch.get_num_threads())
    arrays = (as_array(gradient), to_pos.numpy())
    load_native().edge_gradients(*map(as_array, inputs), instanced, count, simd_name(), *arrays)
    return out


def add_edge_gradients(color: Tensor, rast: Tensor, pos: Tensor, tri: Tensor, opposite: Tensor, threads: int) -> Tensor:
    """Return ``color`` unchanged. The backward pass adds the result of :func:`edge_gradients` to the gradient of
    ``pos``. :func:`fourd.rendering.triangles.edge_gradients` documents the arguments."""
    return _MovingEdges.apply(color, rast, pos, tri, opposite, threads)


class _MovingEdges(torch.autograd.Function):
    """Returns ``color`` unchanged. The backward pass also computes the gradient of ``pos``."""

    @staticmethod
    def forward(
        ctx: Any, color: Tensor, rast: Tensor, pos: Tensor, tri: Tensor, opposite: Tensor, threads: int
    ) -> Tensor:
        ctx.save_for_backward(color, rast, pos, tri, opposite)
        ctx.threads = threads
        return color.view_as(color)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        (gradient,) = gradients
        to_pos = None
        if ctx.needs_input_grad[2]:
            to_pos = edge_gradients(*ctx.saved_tensors, gradient, ctx.threads)
        to_rast = to_tri = to_opposite = to_threads = None
        return gradient, to_rast, to_pos, to_tri, to_opposite, to_threads
