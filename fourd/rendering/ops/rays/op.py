"""Ray tracing: the operator ``torch.ops.fourd.trace_rays`` with its gradient, and functions that build and refit trees.

The public API, which checks the arguments, is :mod:`fourd.rendering.rays`.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import contiguous, load_gpu, uses_gpu_kernels
from fourd.rendering.ops.loading import as_array, load_native, simd_name, thread_count
from fourd.rendering.ops.operator import operator

RayHits = tuple[Tensor, Tensor, Tensor, Tensor]
"""The K nearest hits of each of R rays: t, u, v (R, K) float32 and triangle (R, K) int32."""


def build_tree(xyz: Tensor, tri: Tensor, threads: int) -> tuple[Tensor, Tensor, float]:
    """Build a bounding volume hierarchy of the triangles ``tri`` (T, 3) with the vertices ``xyz`` (V, 3), on the CPU.

    Returns:
        the tree's nodes (N, 64) and blocks of up to eight triangles (B, 80), both on the device of ``xyz``, and the
        largest absolute coordinate of the triangles. Each row has the bytes of one struct Node or Block of
        csrc/rays/rays.h, viewed as float32.
    """
    nodes, blocks, magnitude = load_native().build_rays(as_array(xyz.cpu()), as_array(tri.cpu()), _threads(threads))
    return torch.from_numpy(nodes).to(xyz.device), torch.from_numpy(blocks).to(xyz.device), magnitude


def refit_tree(xyz: Tensor, tri: Tensor, nodes: Tensor, blocks: Tensor, threads: int) -> tuple[Tensor, Tensor, float]:
    """Refit copies of ``nodes`` and ``blocks`` to the new vertex positions ``xyz``. Return the copies and the largest
    absolute coordinate."""
    moved_nodes, moved_blocks = nodes.cpu().clone(), blocks.cpu().clone()
    magnitude = load_native().refit_rays(
        as_array(xyz.cpu()), as_array(tri.cpu()), _threads(threads), moved_nodes.numpy(), moved_blocks.numpy()
    )
    return moved_nodes.to(nodes.device), moved_blocks.to(blocks.device), magnitude


def tree_cost(nodes: Tensor, blocks: Tensor) -> float:
    """Return the expected number of boxes that a random ray hits, given that it hits the root's box."""
    return load_native().rays_cost(as_array(nodes.cpu()), as_array(blocks.cpu()))


@operator("fourd::trace_rays", outputs=lambda origins, layers: _empty_hits(origins, layers))
def trace_rays(
    nodes: Tensor,
    blocks: Tensor,
    magnitude: float,
    xyz: Tensor,
    tri: Tensor,
    origins: Tensor,
    directions: Tensor,
    t_min: Tensor,
    t_max: Tensor,
    after_t: Tensor | None,
    after_triangle: Tensor | None,
    layers: int,
    threads: int,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Find the ``layers`` nearest hits of each ray. Return t, u, v and triangle, each (R, layers).

    ``t_min`` and ``t_max`` have one element for all rays, or one per ray. Only the gradient uses ``xyz`` and ``tri``.
    """
    hits = _empty_hits(origins, layers)
    tensors = (nodes, blocks, origins, directions, t_min, t_max, after_t, after_triangle)
    if uses_gpu_kernels(origins):
        gpu = load_gpu(origins.device)
        arrays = [None if tensor is None else contiguous(tensor) for tensor in tensors]
        with gpu.activate():
            gpu.kernels.trace_rays(*arrays[:2], magnitude, *arrays[2:], gpu.stream, *hits)
        return hits
    arrays = [None if tensor is None else as_array(tensor) for tensor in tensors]
    outputs = [hit.numpy() for hit in hits]
    load_native().trace_rays(*arrays[:2], magnitude, *arrays[2:], _threads(threads), simd_name(), *outputs)
    return hits


@operator(
    "fourd::trace_rays_backward",
    outputs=lambda xyz, origins, directions: (
        torch.empty_like(xyz),
        torch.empty_like(origins),
        torch.empty_like(directions),
    ),
)
def trace_rays_backward(
    xyz: Tensor,
    tri: Tensor,
    origins: Tensor,
    directions: Tensor,
    t: Tensor,
    u: Tensor,
    v: Tensor,
    triangle: Tensor,
    to_t: Tensor,
    to_u: Tensor,
    to_v: Tensor,
    threads: int,
) -> tuple[Tensor, Tensor, Tensor]:
    """Compute the gradients of ``xyz``, ``origins`` and ``directions`` from the gradients (R, K) of t, u and v."""
    gradients = torch.empty_like(xyz), torch.empty_like(origins), torch.empty_like(directions)
    tensors = (xyz, tri, origins, directions, t, u, v, triangle, to_t, to_u, to_v)
    if uses_gpu_kernels(origins):
        gpu = load_gpu(origins.device)
        with gpu.activate():
            gpu.kernels.trace_rays_backward(*(contiguous(tensor) for tensor in tensors), gpu.stream, *gradients)
        return gradients
    load_native().trace_rays_backward(
        *(as_array(tensor) for tensor in tensors), _threads(threads), *(gradient.numpy() for gradient in gradients)
    )
    return gradients


def _setup(ctx: Any, inputs: tuple[Any, ...], output: RayHits) -> None:
    _, _, _, xyz, tri, origins, directions, _, _, _, _, _, ctx.threads = inputs
    ctx.set_materialize_grads(False)
    ctx.mark_non_differentiable(output[3])
    ctx.save_for_backward(xyz, tri, origins, directions, *output)


def _backward(ctx: Any, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
    xyz, tri, origins, directions, t, u, v, triangle = ctx.saved_tensors
    needs_xyz, needs_origins, needs_directions = (ctx.needs_input_grad[k] for k in (3, 5, 6))
    # The tuple has one element for each argument of trace_rays. Only three of the arguments have a gradient.
    none = [None] * 13
    if all(grad is None for grad in grads[:3]) or not (needs_xyz or needs_origins or needs_directions):
        return tuple(none)
    given = [torch.zeros_like(t) if grad is None else grad for grad in grads[:3]]
    to_xyz, to_origins, to_directions = trace_rays_backward(
        xyz, tri, origins, directions, t, u, v, triangle, *given, ctx.threads
    )
    out: list[Tensor | None] = [*none]
    out[3] = to_xyz if needs_xyz else None
    out[5] = to_origins if needs_origins else None
    out[6] = to_directions if needs_directions else None
    return tuple(out)


trace_rays.register_autograd(_backward, setup_context=_setup)


def occluded_rays(
    nodes: Tensor,
    blocks: Tensor,
    magnitude: float,
    origins: Tensor,
    directions: Tensor,
    t_min: Tensor,
    t_max: Tensor,
    threads: int,
) -> Tensor:
    """Return a mask (R,) of the rays that hit a triangle with t in [t_min, t_max]."""
    out = torch.empty(len(origins), dtype=torch.uint8, device=origins.device)
    tensors = (origins, directions, t_min, t_max)
    if uses_gpu_kernels(origins):
        gpu = load_gpu(origins.device)
        arrays = [contiguous(tensor) for tensor in (nodes, blocks, *tensors)]
        with gpu.activate():
            gpu.kernels.occluded_rays(*arrays[:2], magnitude, *arrays[2:], gpu.stream, out)
        return out.bool()
    load_native().occluded_rays(
        as_array(nodes),
        as_array(blocks),
        magnitude,
        *(as_array(tensor) for tensor in tensors),
        _threads(threads),
        simd_name(),
        out.numpy(),
    )
    return out.bool()


def _threads(threads: int) -> int:
    return thread_count(threads, torch.get_num_threads())


def _empty_hits(origins: Tensor, layers: int) -> RayHits:
    shape = (len(origins), layers)
    t, u, v = (origins.new_empty(shape) for _ in range(3))
    return t, u, v, torch.empty(shape, dtype=torch.int32, device=origins.device)
