"""Multi-resolution hash encoding: the operator ``torch.ops.fourd.encode_hash_grid`` and its gradient."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import contiguous, cuda_unavailable_reason, load_gpu, uses_gpu_kernels
from fourd.rendering.ops.hashgrid.reference import encode_hash_grid_reference
from fourd.rendering.ops.hashgrid.shape import HashGridShape, check_hash_grid
from fourd.rendering.ops.loading import as_array, load_native, simd_name, thread_count
from fourd.rendering.ops.operator import operator


def encode_hash_grid(coordinates: Tensor, table: Tensor, shape: HashGridShape) -> Tensor:
    """Interpolate every level of a hash grid trilinearly and concatenate the features.

    This is the encoding of Instant-NGP, with the same constants (Mueller et al. 2022, Instant Neural Graphics
    Primitives with a Multiresolution Hash Encoding, sec. 3). A level with r cells per side has s = r + 1 samples per
    side. In a level with at most 2^log2_entries samples in total, the sample with indices (x, y, z) is in row
    ``x + y * s + z * s^2`` of the level. In a larger level, it is in row
    ``(x xor 2654435761 * y xor 805459861 * z) mod 2^log2_entries``, computed in 32 bits.

    Float32 inputs use a kernel on the CPU, and on a CUDA device if the CUDA kernels are built. Other inputs use
    :func:`fourd.rendering.ops.hashgrid.reference.encode_hash_grid_reference`.

    Args:
        coordinates: (N, 3) x, y, z in [0, 1], float32 or float64. Values outside [0, 1] are clamped; NaN counts as 0.
            The first and last samples of a level are at 0 and 1.
        table: (shape.total_entries, shape.features) features, with the dtype and device of the coordinates.
        shape: sizes of the grid.

    Returns:
        (N, shape.out_features) features, coarsest level first, differentiable in the table and the coordinates. Second
        derivatives are not supported, and clamped coordinates have a gradient of 0. Only the gradients that autograd
        requests are computed. The gradient is bit-identical for any number of threads on the CPU, but its last bits
        vary between calls on a GPU.

    Raises:
        TypeError, ValueError: for an invalid argument, with a message that names the argument and the expected value.
    """
    check_hash_grid(coordinates, table, shape)
    device = coordinates.device.type
    has_kernel = device == "cpu" or (device == "cuda" and not cuda_unavailable_reason())
    if coordinates.dtype == torch.float64 or not has_kernel:
        return encode_hash_grid_reference(coordinates, table, shape)
    return _encode(coordinates, table, shape.resolutions, shape.log2_entries)


@operator(
    "fourd::encode_hash_grid",
    outputs=lambda coordinates, table, resolutions: _empty_rows(coordinates, table, resolutions),
)
def _encode(coordinates: Tensor, table: Tensor, resolutions: Sequence[int], log2_entries: int) -> Tensor:
    out = _empty_rows(coordinates, table, resolutions)
    if uses_gpu_kernels(coordinates):
        gpu = load_gpu(coordinates.device)
        grid = (contiguous(coordinates), contiguous(table), list(resolutions), log2_entries)
        with gpu.activate():
            gpu.kernels.encode_hash_grid(*grid, gpu.stream, out)
        return out
    load_native().encode_hash_grid(
        as_array(coordinates),
        as_array(table),
        list(resolutions),
        log2_entries,
        thread_count(0, torch.get_num_threads()),
        simd_name(),
        out.numpy(),
    )
    return out


@operator(
    "fourd::encode_hash_grid_backward",
    outputs=lambda coordinates, table, needs_coordinates, needs_table: _empty_gradients(
        coordinates, table, needs_coordinates, needs_table
    ),
)
def _encode_backward(
    coordinates: Tensor,
    table: Tensor,
    resolutions: Sequence[int],
    log2_entries: int,
    gradient: Tensor,
    needs_coordinates: bool,
    needs_table: bool,
) -> tuple[Tensor, Tensor]:
    grad_coordinates, grad_table = _empty_gradients(coordinates, table, needs_coordinates, needs_table)
    if uses_gpu_kernels(coordinates):
        gpu = load_gpu(coordinates.device)
        grid = (contiguous(coordinates), contiguous(table), list(resolutions), log2_entries)
        targets = (grad_table if needs_table else None, grad_coordinates if needs_coordinates else None)
        with gpu.activate():
            gpu.kernels.encode_hash_grid_backward(*grid, gpu.stream, contiguous(gradient), *targets)
        return grad_coordinates, grad_table
    load_native().encode_hash_grid_backward(
        as_array(coordinates),
        as_array(table),
        list(resolutions),
        log2_entries,
        thread_count(0, torch.get_num_threads()),
        simd_name(),
        as_array(gradient),
        grad_table.numpy() if needs_table else None,
        grad_coordinates.numpy() if needs_coordinates else None,
    )
    return grad_coordinates, grad_table


def _setup(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    coordinates, table, ctx.resolutions, ctx.log2_entries = inputs
    ctx.save_for_backward(coordinates, table)


def _backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, Tensor | None, None, None]:
    needs_coordinates, needs_table = (bool(needed) for needed in ctx.needs_input_grad[:2])
    grid = (*ctx.saved_tensors, ctx.resolutions, ctx.log2_entries)
    grad_coordinates, grad_table = _encode_backward(*grid, gradient, needs_coordinates, needs_table)
    # The arguments resolutions and log2_entries have no gradient.
    return grad_coordinates if needs_coordinates else None, grad_table if needs_table else None, None, None


_encode.register_autograd(_backward, setup_context=_setup)


def _empty_rows(coordinates: Tensor, table: Tensor, resolutions: Sequence[int]) -> Tensor:
    return coordinates.new_empty(coordinates.shape[0], len(resolutions) * table.shape[1])


def _empty_gradients(
    coordinates: Tensor, table: Tensor, needs_coordinates: bool, needs_table: bool
) -> tuple[Tensor, Tensor]:
    """Allocate the gradients of coordinates and table. A gradient that is not needed is an empty tensor."""
    return (
        coordinates.new_empty(coordinates.shape[0] if needs_coordinates else 0, 3),
        table.new_empty(table.shape[0] if needs_table else 0, table.shape[1]),
    )
