"""Antialiasing of silhouette edges: the operator ``torch.ops.fourd.antialias`` and its gradient.

The public API, which checks the arguments and selects the backend, is :mod:`fourd.rendering.triangles.antialiasing`.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import contiguous, load_gpu, uses_gpu_kernels
from fourd.rendering.ops.loading import as_array, load_native, simd_name, thread_count
from fourd.rendering.ops.operator import operator


@operator("fourd::antialias", outputs=lambda color: _empty_outputs(color))
def antialias(
    color: Tensor, rast: Tensor, pos: Tensor, tri: Tensor, opposite: Tensor, boost: float, threads: int
) -> tuple[Tensor, Tensor]:
    """Return the antialiased image (B, H, W, C), and an array (B, H, W) uint8 that contains one code per pixel. The
    backward pass needs the codes.

    ``pos`` is (B, V, 4), or (V, 4) if all images have the same vertices. A pixel forms one pair with its right
    neighbour and one with its lower neighbour. For each of the two pairs, the pixel's code stores which silhouette edge
    passes between the pixel centres. ``csrc/antialias/maths.h`` describes the bits of the code.
    """
    out, codes = _empty_outputs(color)
    inputs = (color, rast, pos if pos.ndim == 3 else pos[None], tri, opposite)
    instanced = pos.ndim == 3
    if uses_gpu_kernels(color):
        gpu = load_gpu(color.device)
        with gpu.activate():
            workspace = gpu.allocate(gpu.kernels.antialias_workspace_bytes(tri.shape[0], color.shape[0], instanced))
            gpu.kernels.antialias(*map(contiguous, inputs), instanced, workspace, gpu.stream, out, codes)
        return out, codes
    count = thread_count(threads, torch.get_num_threads())
    load_native().antialias(*map(as_array, inputs), instanced, count, simd_name(), out.numpy(), codes.numpy())
    return out, codes


@operator(
    "fourd::antialias_backward",
    outputs=lambda color, pos, needs_color, needs_pos: _empty_gradients(color, pos, needs_color, needs_pos),
)
def antialias_backward(
    color: Tensor,
    rast: Tensor,
    pos: Tensor,
    tri: Tensor,
    gradient: Tensor,
    codes: Tensor,
    boost: float,
    needs_color: bool,
    needs_pos: bool,
    threads: int,
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of ``color`` and ``pos``. A gradient that is not needed is an empty tensor."""
    grad_color, grad_pos = _empty_gradients(color, pos, needs_color, needs_pos)
    inputs = (color, rast, pos if pos.ndim == 3 else pos[None], tri)
    instanced = pos.ndim == 3
    to_color = grad_color if needs_color else None
    to_pos = (grad_pos if instanced else grad_pos[None]) if needs_pos else None
    if uses_gpu_kernels(color):
        gpu = load_gpu(color.device)
        upstream = (contiguous(gradient), contiguous(codes), boost)
        with gpu.activate():
            gpu.kernels.antialias_backward(*map(contiguous, inputs), instanced, gpu.stream, *upstream, to_color, to_pos)
        return grad_color, grad_pos
    load_native().antialias_backward(
        *map(as_array, inputs),
        instanced,
        thread_count(threads, torch.get_num_threads()),
        simd_name(),
        as_array(gradient),
        as_array(codes),
        boost,
        None if to_color is None else to_color.numpy(),
        None if to_pos is None else to_pos.numpy(),
    )
    return grad_color, grad_pos


def _setup(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
    color, rast, pos, tri, _, boost, threads = inputs
    ctx.save_for_backward(color, rast, pos, tri, output[1])
    ctx.mark_non_differentiable(output[1])
    ctx.settings = (boost, threads)


def _backward(ctx: Any, gradient: Tensor, _: Tensor | None) -> tuple[Tensor | None, ...]:
    color, rast, pos, tri, codes = ctx.saved_tensors
    boost, threads = ctx.settings
    needs_color, needs_pos = bool(ctx.needs_input_grad[0]), bool(ctx.needs_input_grad[2])
    grad_color, grad_pos = antialias_backward(
        color, rast, pos, tri, gradient, codes, boost, needs_color, needs_pos, threads
    )
    to_rast = to_tri = to_opposite = to_boost = to_threads = None
    return (
        (grad_color if needs_color else None),
        to_rast,
        (grad_pos if needs_pos else None),
        to_tri,
        to_opposite,
        to_boost,
        to_threads,
    )


antialias.register_autograd(_backward, setup_context=_setup)


def _empty_outputs(color: Tensor) -> tuple[Tensor, Tensor]:
    out = torch.empty_like(color, memory_format=torch.contiguous_format)
    return out, color.new_empty(color.shape[:3], dtype=torch.uint8)


def _empty_gradients(color: Tensor, pos: Tensor, needs_color: bool, needs_pos: bool) -> tuple[Tensor, Tensor]:
    return color.new_empty(color.shape if needs_color else (0,)), pos.new_empty(pos.shape if needs_pos else (0,))
