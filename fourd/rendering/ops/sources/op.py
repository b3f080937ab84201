"""Sampling of source views at projected points: the operator ``torch.ops.fourd.sample_sources`` and its gradient."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.gpu import contiguous, cuda_unavailable_reason, load_gpu, uses_gpu_kernels
from fourd.rendering.ops.loading import load_native, simd_name, thread_count
from fourd.rendering.ops.operator import kernel_array, operator, uninitialised
from fourd.rendering.ops.sources.reference import sample_sources_reference

MAX_VIEWS_GPU = 16


def sample_sources(
    xyz: Tensor,
    features: Tensor | None,
    images: Tensor,
    mattes: Tensor,
    depth: Tensor | None,
    cameras: list[float],
    softness: Tensor,
) -> tuple[Tensor, Tensor]:
    """Project points into every source view, and sample the view bilinearly at the projections.

    Float32 inputs use a kernel on the CPU, and on a CUDA device if the CUDA kernels are built and
    there are at most 16 views. Other inputs use :func:`fourd.rendering.ops.sources.reference.sample_sources_reference`.

    Args:
        xyz: (N, 3) world points.
        features: (V, C, h, w) image features, or None. Their resolution may differ from that of ``images``. Features in
            torch's channels_last format are not copied.
        images: (V, 3, H, W) colours in [0, 1]. Not differentiable.
        mattes: (V, H, W) opacity in [0, 1], 1 where the object covers the pixel. Not differentiable.
        depth: (V, H, W) depth of the nearest surface in world units, infinite where there is none. If None, occlusion
            is not tested. Not differentiable.
        cameras: concatenated results of :func:`fourd.rendering.ops.points.validation.pack_camera` for all views.
        softness: (N,) positive decay lengths of the points in world units. A point's occlusion factor is 1 up to two
            decay lengths behind the surface, and decays exponentially beyond that. Not differentiable.

    Returns:
        The pair (channels, visibility). The channels (V, C + 3, N) are the features followed by RGB, differentiable in
        ``xyz`` and ``features``. The visibility weights (V, N) are in [0, 1] and not differentiable. A visibility
        weight is the squared matte times the occlusion factor, and 0 for points behind the camera. Squaring the matte
        makes the weight at the silhouette, where pixels contain background colour, lower than the coverage.

    Raises:
        ValueError: if shapes do not match.
    """
    device = xyz.device.type
    cuda_works = device == "cuda" and not cuda_unavailable_reason() and images.shape[0] <= MAX_VIEWS_GPU
    if xyz.dtype != torch.float32 or not (device == "cpu" or cuda_works):
        return sample_sources_reference(xyz, features, images, mattes, depth, cameras, softness)
    return _sample(xyz, features, images, mattes, depth, cameras, softness)


@operator("fourd::sample_sources", outputs=lambda xyz, features, images: _empty_samples(xyz, features, images))
def _sample(
    xyz: Tensor,
    features: Tensor | None,
    images: Tensor,
    mattes: Tensor,
    depth: Tensor | None,
    cameras: list[float],
    softness: Tensor,
) -> tuple[Tensor, Tensor]:
    out = _empty_samples(xyz, features, images)
    if uses_gpu_kernels(xyz):
        gpu = load_gpu(xyz.device)
        maps = (contiguous(images), contiguous(mattes), _contiguous(depth), _contiguous(_channels_last(features)))
        with gpu.activate():
            gpu.kernels.sample_sources(contiguous(xyz), *maps, cameras, contiguous(softness), gpu.stream, *out)
        return out
    load_native().sample_sources(
        kernel_array(xyz),
        kernel_array(images),
        kernel_array(mattes),
        _optional_array(depth),
        _optional_array(_channels_last(features)),
        cameras,
        kernel_array(softness),
        thread_count(0, torch.get_num_threads()),
        simd_name(),
        *map(kernel_array, out),
    )
    return out


@operator(
    "fourd::sample_sources_backward",
    outputs=lambda xyz, features, needs_features: _empty_gradients(xyz, features, needs_features),
)
def _sample_backward(
    xyz: Tensor,
    features: Tensor | None,
    images: Tensor,
    mattes: Tensor,
    cameras: list[float],
    gradient: Tensor,
    needs_features: bool,
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of ``xyz`` and ``features``. The gradient of ``features`` is empty if
    ``needs_features`` is False."""
    grad_xyz, grad_features = _empty_gradients(xyz, features, needs_features)
    feature_rows = _channels_last(grad_features) if needs_features else None
    if uses_gpu_kernels(xyz):
        gpu = load_gpu(xyz.device)
        maps = (contiguous(images), contiguous(mattes), _contiguous(_channels_last(features)))
        with gpu.activate():
            gpu.kernels.sample_sources_backward(
                contiguous(xyz), *maps, cameras, gpu.stream, contiguous(gradient), grad_xyz, feature_rows
            )
        return grad_xyz, grad_features
    load_native().sample_sources_backward(
        kernel_array(xyz),
        kernel_array(images),
        kernel_array(mattes),
        _optional_array(_channels_last(features)),
        cameras,
        thread_count(0, torch.get_num_threads()),
        simd_name(),
        kernel_array(gradient),
        kernel_array(grad_xyz),
        _optional_array(feature_rows),
    )
    return grad_xyz, grad_features


def _setup(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
    xyz, features, images, mattes, _, cameras, _ = inputs
    ctx.set_materialize_grads(False)
    ctx.save_for_backward(xyz, features, images, mattes)
    ctx.cameras = cameras


def _backward(
    ctx: Any, gradient: Tensor | None, grad_visibility: Tensor | None
) -> tuple[Tensor | None, Tensor | None, None, None, None, None, None]:
    xyz, features, images, mattes = ctx.saved_tensors
    if gradient is None:
        return None, None, None, None, None, None, None
    needs_features = bool(ctx.needs_input_grad[1])
    grad_xyz, grad_features = _sample_backward(xyz, features, images, mattes, ctx.cameras, gradient, needs_features)
    return grad_xyz, grad_features if needs_features else None, None, None, None, None, None


_sample.register_autograd(_backward, setup_context=_setup)


def _contiguous(tensor: Tensor | None) -> Tensor | None:
    return None if tensor is None else contiguous(tensor)


def _optional_array(tensor: Tensor | None) -> Any:
    return None if tensor is None else kernel_array(tensor)


def _channels_last(features: Tensor | None) -> Tensor | None:
    """Return a view (V, h, w, C) of the features (V, C, h, w), which is contiguous if they are in channels_last
    format."""
    return None if features is None else features.permute(0, 2, 3, 1)


def _empty_samples(xyz: Tensor, features: Tensor | None, images: Tensor) -> tuple[Tensor, Tensor]:
    views, count = images.shape[0], xyz.shape[0]
    channels = 3 + (0 if features is None else features.shape[1])
    return uninitialised(xyz, views, channels, count), uninitialised(xyz, views, count)


def _empty_gradients(xyz: Tensor, features: Tensor | None, needs_features: bool) -> tuple[Tensor, Tensor]:
    grad_xyz = uninitialised(xyz, *xyz.shape)
    if features is None or not needs_features:
        return grad_xyz, uninitialised(xyz, 0)
    return grad_xyz, torch.empty_like(features, memory_format=torch.channels_last)
