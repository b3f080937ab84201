"""The CUDA kernels of ``csrc/points`` for torch tensors: room for what they draw, and the calls."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from fourd.ops.gpu import Gpu, dense, load_gpu

MOST_LAYERS_BACKWARD = 64


def render(
    inputs: tuple[Tensor, Tensor, Tensor, Tensor],
    camera: list[float],
    layers: int,
    near: float,
    transmittance_min: float,
    out: tuple[Tensor, Tensor, Tensor],
) -> None:
    """Draw xyz, features, radius and density into features (H, W, C), alpha and depth (H, W)."""
    gpu = load_gpu(inputs[0].device)
    height, width = out[1].shape
    with gpu.current():
        room = _room(gpu, inputs[0].shape[0], inputs[1].shape[1], width, height)
        gpu.kernels.render_points(*_all_dense(inputs), camera, layers, near, transmittance_min, *room, gpu.stream, *out)


def render_backward(
    inputs: tuple[Tensor, Tensor, Tensor, Tensor],
    camera: list[float],
    layers: int,
    near: float,
    gradients: tuple[Tensor, Tensor, Tensor | None],
    out: tuple[Tensor, Tensor, Tensor, Tensor],
) -> None:
    """Gradients of the inputs from those of the image's features, alpha and depth."""
    gpu = load_gpu(inputs[0].device)
    height, width = gradients[1].shape
    with gpu.current():
        room = _room(gpu, inputs[0].shape[0], inputs[1].shape[1], width, height)
        gpu.kernels.render_points_backward(
            *_all_dense(inputs),
            camera,
            layers,
            near,
            *room,
            gpu.stream,
            *_all_dense(gradients[:2]),
            None if gradients[2] is None else dense(gradients[2]),
            *out,
        )


def visibility(
    inputs: tuple[Tensor, Tensor, Tensor],
    camera: list[float],
    size: tuple[int, int],
    layers: int,
    near: float,
    out: Tensor,
) -> None:
    """The largest weight (N,) of xyz, radius and density in any pixel of a picture of ``size`` (width, height)."""
    gpu = load_gpu(inputs[0].device)
    with gpu.current():
        room = _room(gpu, inputs[0].shape[0], 0, *size)
        gpu.kernels.point_visibility(*_all_dense(inputs), camera, *size, layers, near, *room, gpu.stream, out)


def _room(gpu: Gpu, count: int, channels: int, width: int, height: int) -> tuple[Any, int, Tensor]:
    entries, size = gpu.kernels.plan_points(gpu.rooms, count, channels, width, height)
    return gpu.rooms, entries, gpu.memory(size)


def _all_dense(tensors: tuple[Tensor, ...]) -> list[Tensor]:
    return [dense(tensor) for tensor in tensors]
