"""Interpolation of vertex attributes: the operator ``torch.ops.fourd.interpolate_attributes`` and its gradient.

The public API, which checks the arguments and selects the backend, is :mod:`fourd.rendering.triangles.interpolation`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import contiguous, load_gpu, uses_gpu_kernels
from fourd.rendering.ops.loading import as_array, load_native, simd_name, thread_count
from fourd.rendering.ops.operator import operator


@operator("fourd::interpolate_attributes", outputs=lambda attr, rast, diff: _empty_images(attr, rast, diff))
def interpolate_attributes(
    attr: Tensor, rast: Tensor, tri: Tensor, rast_db: Tensor | None, diff: Sequence[int], threads: int
) -> tuple[Tensor, Tensor]:
    """Interpolate ``attr`` (B or 1, V, C). Return the values (B, H, W, C), and the derivatives (B, H, W, 2 * len(diff))
    of the channels ``diff`` along the image's x and y axes. ``rast_db`` may be None if ``diff`` is empty."""
    out, out_da = _empty_images(attr, rast, diff)
    if uses_gpu_kernels(attr):
        gpu = load_gpu(attr.device)
        with gpu.activate():
            gpu.kernels.interpolate_attributes(*_gpu_arrays(attr, rast, tri, rast_db, diff), gpu.stream, out, out_da)
        return out, out_da
    load_native().interpolate_attributes(
        *_arrays(attr, rast, tri, rast_db, diff),
        thread_count(threads, torch.get_num_threads()),
        simd_name(),
        out.numpy(),
        out_da.numpy(),
    )
    return out, out_da


@operator(
    "fourd::interpolate_attributes_backward", outputs=lambda attr, rast, needed: _empty_gradients(attr, rast, needed)
)
def interpolate_attributes_backward(
    attr: Tensor,
    rast: Tensor,
    tri: Tensor,
    rast_db: Tensor | None,
    diff: Sequence[int],
    grad_out: Tensor,
    grad_da: Tensor,
    needed: Sequence[bool],
    threads: int,
) -> tuple[Tensor, Tensor, Tensor]:
    """Compute the gradients of ``attr``, ``rast`` and ``rast_db``. The three bools ``needed`` select the gradients to
    compute. The other gradients are empty tensors."""
    gradients = _empty_gradients(attr, rast, needed)
    targets = [gradient if is_needed else None for gradient, is_needed in zip(gradients, needed, strict=True)]
    if uses_gpu_kernels(attr):
        gpu = load_gpu(attr.device)
        with gpu.activate():
            gpu.kernels.interpolate_attributes_backward(
                *_gpu_arrays(attr, rast, tri, rast_db, diff),
                gpu.stream,
                contiguous(grad_out),
                contiguous(grad_da),
                *targets,
            )
        return gradients
    load_native().interpolate_attributes_backward(
        *_arrays(attr, rast, tri, rast_db, diff),
        thread_count(threads, torch.get_num_threads()),
        simd_name(),
        as_array(grad_out),
        as_array(grad_da),
        *(None if target is None else target.numpy() for target in targets),
    )
    return gradients


def _setup(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
    attr, rast, tri, rast_db, ctx.diff, ctx.threads = inputs
    ctx.set_materialize_grads(False)
    ctx.save_for_backward(attr, rast, tri, rast_db)


def _backward(ctx: Any, grad_out: Tensor | None, grad_da: Tensor | None) -> tuple[Tensor | None, ...]:
    attr, rast, tri, rast_db = ctx.saved_tensors
    needs_attr, needs_rast, _, needs_db, _, _ = ctx.needs_input_grad
    needed = [needs_attr, needs_rast, needs_db and len(ctx.diff) > 0]
    # The arguments tri, diff and threads have no gradient.
    if (grad_out is None and grad_da is None) or not any(needed):
        return None, None, None, None, None, None
    if grad_out is None:
        grad_out = attr.new_zeros(*rast.shape[:3], attr.shape[2])
    if grad_da is None:
        grad_da = attr.new_zeros(*rast.shape[:3], 2 * len(ctx.diff))
    gradients = interpolate_attributes_backward(
        attr, rast, tri, rast_db, ctx.diff, grad_out, grad_da, needed, ctx.threads
    )
    grad_attr, grad_rast, grad_db = (
        gradient if is_needed else None for gradient, is_needed in zip(gradients, needed, strict=True)
    )
    return grad_attr, grad_rast, None, grad_db, None, None


interpolate_attributes.register_autograd(_backward, setup_context=_setup)


def _arrays(attr: Tensor, rast: Tensor, tri: Tensor, rast_db: Tensor | None, diff: Sequence[int]) -> list[Any]:
    channels = torch.tensor(list(diff), dtype=torch.int32)
    return [None if tensor is None else as_array(tensor) for tensor in (attr, rast, tri, rast_db, channels)]


def _gpu_arrays(
    attr: Tensor, rast: Tensor, tri: Tensor, rast_db: Tensor | None, diff: Sequence[int]
) -> list[Tensor | None]:
    channels = torch.tensor(list(diff), dtype=torch.int32, device=attr.device)
    return [None if tensor is None else contiguous(tensor) for tensor in (attr, rast, tri, rast_db, channels)]


def _empty_images(attr: Tensor, rast: Tensor, diff: Sequence[int]) -> tuple[Tensor, Tensor]:
    return attr.new_empty(*rast.shape[:3], attr.shape[2]), attr.new_empty(*rast.shape[:3], 2 * len(diff))


def _empty_gradients(attr: Tensor, rast: Tensor, needed: Sequence[bool]) -> tuple[Tensor, Tensor, Tensor]:
    needs_attr, needs_rast, needs_db = needed
    return (
        attr.new_empty(attr.shape if needs_attr else (0,)),
        rast.new_empty(rast.shape if needs_rast else (0,)),
        rast.new_empty(rast.shape if needs_db else (0,)),
    )
