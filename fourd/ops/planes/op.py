"""Points looked up in feature planes: ``torch.ops.fourd.sample_planes``, its gradient, and the same in plain torch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from fourd.ops.gpu import cuda_unavailable_reason, dense, load_gpu, takes
from fourd.ops.loading import as_array, native, simd_name, thread_count

MOST_PLANES_GPU = 64


def sample_planes(coordinates: Tensor, planes: Sequence[Tensor], axes: Sequence[int]) -> Tensor:
    """Bilinear samples of every plane, side by side (K-Planes, Fridovich-Keil et al. 2023, eq. 1).

    Args:
        coordinates: (N, 4) x, y, z, t in [-1, 1]; what lies outside is clamped to the border, and
            what is no number counts as -1. Float32 on the CPU or, where its kernels are built, on a
            CUDA device; anything else is looked up by :func:`sample_planes_reference`.
        planes: each (rows, columns, F) of the coordinates' dtype, F from 1 to 64 and the same in all.
            The first and last samples lie on the borders.
        axes: two numbers from 0 to 3 a plane: the coordinate along its columns and that down its rows.

    Returns:
        (N, F * len(planes)), differentiable in the planes and the coordinates. On the CPU the gradient
        is the same for any number of threads, which FOURD_THREADS sets (else torch.get_num_threads()); on a
        GPU its last bits differ from run to run.

    Raises:
        TypeError, ValueError: naming the argument, what was expected and what came.
    """
    _check(coordinates, planes, axes)
    device = coordinates.device.type
    kernels = device == "cpu" or (device == "cuda" and not cuda_unavailable_reason() and len(planes) <= MOST_PLANES_GPU)
    if coordinates.dtype == torch.float64 or not kernels:
        return sample_planes_reference(coordinates, planes, axes)
    return _sample(coordinates, list(planes), list(axes))


def sample_planes_reference(coordinates: Tensor, planes: Sequence[Tensor], axes: Sequence[int]) -> Tensor:
    """What :func:`sample_planes` promises, in plain torch; any device, float32 or float64."""
    samples = []
    for k, plane in enumerate(planes):
        grid = coordinates[:, [axes[2 * k], axes[2 * k + 1]]].nan_to_num(nan=-1.0).reshape(1, 1, -1, 2)
        values = plane.permute(2, 0, 1)[None]
        found = functional.grid_sample(values, grid, align_corners=True, padding_mode="border")
        samples.append(found[0, :, 0].T)
    return torch.cat(samples, dim=1)


def _check(coordinates: Tensor, planes: Sequence[Tensor], axes: Sequence[int]) -> None:
    if coordinates.ndim != 2 or coordinates.shape[1] != 4:
        raise ValueError(f"coordinates: expected shape (N, 4), got {tuple(coordinates.shape)}")
    if len(planes) == 0 or len(axes) != 2 * len(planes):
        raise ValueError(f"axes: expected two for each of {len(planes)} planes, got {len(axes)}")
    for name, tensor in (("coordinates", coordinates), *((f"planes[{k}]", plane) for k, plane in enumerate(planes))):
        if tensor.dtype != coordinates.dtype or tensor.dtype not in (torch.float32, torch.float64):
            expected = "float32 or float64, the same in all"
            raise TypeError(f"{name}: expected {expected}, got {str(tensor.dtype).removeprefix('torch.')}")
        if tensor.device != coordinates.device:
            raise ValueError(f"{name}: expected device {coordinates.device} as coordinates has, got {tensor.device}")
    for k, plane in enumerate(planes):
        if plane.ndim != 3 or min(plane.shape[:2]) < 2 or plane.shape[2] != planes[0].shape[2]:
            expected = f"(2 or more, 2 or more, {planes[0].shape[-1]})"
            raise ValueError(f"planes[{k}]: expected shape {expected}, got {tuple(plane.shape)}")


@torch.library.custom_op("fourd::sample_planes", mutates_args=(), device_types=("cpu", "cuda"))
def _sample(coordinates: Tensor, planes: Sequence[Tensor], axes: Sequence[int]) -> Tensor:
    out = _empty_samples(coordinates, planes)
    if takes(coordinates):
        gpu = load_gpu(coordinates.device)
        with gpu.current():
            gpu.kernels.sample_planes(dense(coordinates), [dense(plane) for plane in planes], axes, gpu.stream, out)
        return out
    threads = thread_count(0, torch.get_num_threads())
    arrays = [as_array(plane) for plane in planes]
    native().sample_planes(as_array(coordinates), arrays, list(axes), threads, simd_name(), out.numpy())
    return out


@_sample.register_fake
def _(coordinates: Tensor, planes: Sequence[Tensor], axes: Sequence[int]) -> Tensor:
    return _empty_samples(coordinates, planes)


@torch.library.custom_op("fourd::sample_planes_backward", mutates_args=(), device_types=("cpu", "cuda"))
def _sample_backward(
    coordinates: Tensor, planes: Sequence[Tensor], axes: Sequence[int], gradient: Tensor, moves: bool
) -> tuple[list[Tensor], Tensor]:
    grad_planes, grad_coordinates = _empty_gradients(coordinates, planes, moves)
    if takes(coordinates):
        gpu = load_gpu(coordinates.device)
        arrays = (dense(coordinates), [dense(plane) for plane in planes], axes, gpu.stream, dense(gradient))
        with gpu.current():
            gpu.kernels.sample_planes_backward(*arrays, grad_planes, grad_coordinates if moves else None)
        return grad_planes, grad_coordinates
    native().sample_planes_backward(
        as_array(coordinates),
        [as_array(plane) for plane in planes],
        list(axes),
        thread_count(0, torch.get_num_threads()),
        simd_name(),
        as_array(gradient),
        [plane.numpy() for plane in grad_planes],
        grad_coordinates.numpy() if moves else None,
    )
    return grad_planes, grad_coordinates


@_sample_backward.register_fake
def _(
    coordinates: Tensor, planes: Sequence[Tensor], axes: Sequence[int], gradient: Tensor, moves: bool
) -> tuple[list[Tensor], Tensor]:
    return _empty_gradients(coordinates, planes, moves)


def _setup(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    coordinates, planes, axes = inputs
    ctx.save_for_backward(coordinates, *planes)
    ctx.axes = axes


def _backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, list[Tensor], None]:
    coordinates, *planes = ctx.saved_tensors
    moves = bool(ctx.needs_input_grad[0])
    grad_planes, grad_coordinates = _sample_backward(coordinates, planes, ctx.axes, gradient, moves)
    return (grad_coordinates if moves else None), grad_planes, None


_sample.register_autograd(_backward, setup_context=_setup)


def _empty_samples(coordinates: Tensor, planes: Sequence[Tensor]) -> Tensor:
    return coordinates.new_empty(coordinates.shape[0], len(planes) * planes[0].shape[2])


def _empty_gradients(coordinates: Tensor, planes: Sequence[Tensor], moves: bool) -> tuple[list[Tensor], Tensor]:
    """Room for the gradients; of no coordinates unless these are wanted."""
    grad_planes = [torch.empty_like(plane, memory_format=torch.contiguous_format) for plane in planes]
    return grad_planes, coordinates.new_empty(coordinates.shape if moves else (0, 4))
