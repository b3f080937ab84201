"""Bilinear sampling of feature planes: the operator ``torch.ops.fourd.sample_planes`` and its gradient."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import contiguous, cuda_unavailable_reason, load_gpu, uses_gpu_kernels
from fourd.rendering.ops.loading import load_native, simd_name, thread_count
from fourd.rendering.ops.operator import kernel_array, operator, uninitialised
from fourd.rendering.ops.planes.reference import sample_planes_reference

MAX_PLANES_GPU = 64


def sample_planes(coordinates: Tensor, planes: Sequence[Tensor], axes: Sequence[int]) -> Tensor:
    """Sample every plane bilinearly and concatenate the features (K-Planes, Fridovich-Keil et al. 2023, eq. 1).

    Float32 inputs use a kernel on the CPU, and on a CUDA device if the CUDA kernels are built and
    there are at most 64 planes. Other inputs use :func:`fourd.rendering.ops.planes.reference.sample_planes_reference`.

    Args:
        coordinates: (N, 4) x, y, z, t in [-1, 1], float32 or float64. Values outside [-1, 1] are clamped; NaN counts as
            -1.
        planes: tensors of shape (rows, columns, F) with the dtype of the coordinates and at least 2 rows and 2 columns.
            All planes have the same number of features F, from 1 to 64. A plane's first and last samples are at -1 and
            1 (align_corners).
        axes: two coordinate indices per plane, from 0 to 3. The first coordinate selects the plane's column, the second
            its row.

    Returns:
        (N, F * len(planes)) features, differentiable in the planes and the coordinates. The gradient is bit-identical
        for any number of threads on the CPU, but its last bits vary between calls on a GPU.

    Raises:
        TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
    """
    _check(coordinates, planes, axes)
    device = coordinates.device.type
    cuda_works = device == "cuda" and not cuda_unavailable_reason() and len(planes) <= MAX_PLANES_GPU
    if coordinates.dtype == torch.float64 or not (device == "cpu" or cuda_works):
        return sample_planes_reference(coordinates, planes, axes)
    return _sample(coordinates, list(planes), list(axes))


def _check(coordinates: Tensor, planes: Sequence[Tensor], axes: Sequence[int]) -> None:
    if coordinates.ndim != 2 or coordinates.shape[1] != 4:
        raise ValueError(f"coordinates: expected shape (N, 4), got {tuple(coordinates.shape)}")
    if len(planes) == 0 or len(axes) != 2 * len(planes):
        raise ValueError(f"axes: expected two indices for each of {len(planes)} planes, got {len(axes)} indices")
    for name, tensor in (("coordinates", coordinates), *((f"planes[{k}]", plane) for k, plane in enumerate(planes))):
        if tensor.dtype != coordinates.dtype or tensor.dtype not in (torch.float32, torch.float64):
            expected = "float32 or float64 in all tensors"
            raise TypeError(f"{name}: expected {expected}, got {str(tensor.dtype).removeprefix('torch.')}")
        if tensor.device != coordinates.device:
            raise ValueError(f"{name}: expected device {coordinates.device} like coordinates, got {tensor.device}")
    for k, plane in enumerate(planes):
        if plane.ndim != 3 or min(plane.shape[:2]) < 2 or plane.shape[2] != planes[0].shape[2]:
            expected = f"(2 or more, 2 or more, {planes[0].shape[-1]})"
            raise ValueError(f"planes[{k}]: expected shape {expected}, got {tuple(plane.shape)}")


@operator("fourd::sample_planes", outputs=lambda coordinates, planes: _empty_samples(coordinates, planes))
def _sample(coordinates: Tensor, planes: Sequence[Tensor], axes: Sequence[int]) -> Tensor:
    out = _empty_samples(coordinates, planes)
    if uses_gpu_kernels(coordinates):
        gpu = load_gpu(coordinates.device)
        with gpu.activate():
            tensors = (contiguous(coordinates), [contiguous(plane) for plane in planes])
            gpu.kernels.sample_planes(*tensors, axes, gpu.stream, out)
        return out
    threads = thread_count(0, torch.get_num_threads())
    arrays = [kernel_array(plane) for plane in planes]
    load_native().sample_planes(kernel_array(coordinates), arrays, list(axes), threads, simd_name(), kernel_array(out))
    return out


@operator(
    "fourd::sample_planes_backward",
    outputs=lambda coordinates, planes, needs_coordinates: _empty_gradients(coordinates, planes, needs_coordinates),
)
def _sample_backward(
    coordinates: Tensor, planes: Sequence[Tensor], axes: Sequence[int], gradient: Tensor, needs_coordinates: bool
) -> tuple[list[Tensor], Tensor]:
    grad_planes, grad_coordinates = _empty_gradients(coordinates, planes, needs_coordinates)
    if uses_gpu_kernels(coordinates):
        gpu = load_gpu(coordinates.device)
        arrays = (
            contiguous(coordinates),
            [contiguous(plane) for plane in planes],
            axes,
            gpu.stream,
            contiguous(gradient),
        )
        with gpu.activate():
            gpu.kernels.sample_planes_backward(*arrays, grad_planes, grad_coordinates if needs_coordinates else None)
        return grad_planes, grad_coordinates
    load_native().sample_planes_backward(
        kernel_array(coordinates),
        [kernel_array(plane) for plane in planes],
        list(axes),
        thread_count(0, torch.get_num_threads()),
        simd_name(),
        kernel_array(gradient),
        [kernel_array(plane) for plane in grad_planes],
        kernel_array(grad_coordinates) if needs_coordinates else None,
    )
    return grad_planes, grad_coordinates


def _setup(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    coordinates, planes, axes = inputs
    ctx.save_for_backward(coordinates, *planes)
    ctx.axes = axes


def _backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, list[Tensor], None]:
    coordinates, *planes = ctx.saved_tensors
    needs_coordinates = bool(ctx.needs_input_grad[0])
    grad_planes, grad_coordinates = _sample_backward(coordinates, planes, ctx.axes, gradient, needs_coordinates)
    return (grad_coordinates if needs_coordinates else None), grad_planes, None


_sample.register_autograd(_backward, setup_context=_setup)


def _empty_samples(coordinates: Tensor, planes: Sequence[Tensor]) -> Tensor:
    return uninitialised(coordinates, coordinates.shape[0], len(planes) * planes[0].shape[2])


def _empty_gradients(
    coordinates: Tensor, planes: Sequence[Tensor], needs_coordinates: bool
) -> tuple[list[Tensor], Tensor]:
    """Allocate the gradients. If the coordinates need no gradient, their gradient is an empty tensor."""
    grad_planes = [uninitialised(plane, *plane.shape) for plane in planes]
    return grad_planes, uninitialised(coordinates, *(coordinates.shape if needs_coordinates else (0, 4)))
