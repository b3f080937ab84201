"""Source views sampled: ``torch.ops.fourd.sample_sources`` and its gradient.

What they compute is :func:`fourd.model.sources.sample_sources_reference`. With FOURD_SIMD=emulated the CPU runs the
CUDA kernel's source, for tests.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fourd.ops.gpu import dense, load_gpu, takes
from fourd.ops.loading import as_array, native, simd_name, thread_count

MAX_VIEWS_GPU = 16


@torch.library.custom_op("fourd::sample_sources", mutates_args=(), device_types=("cpu", "cuda"))
def sample(
    xyz: Tensor,
    features: Tensor | None,
    images: Tensor,
    mattes: Tensor,
    depth: Tensor | None,
    cameras: list[float],
    softness: Tensor,
) -> tuple[Tensor, Tensor]:
    """Channels (V, C + 3, N) and trust (V, N) of points (N, 3) in V views.

    Args:
        features: (V, C, h, w), or None. In torch's channels_last format they are read as they are, else copied.
        images, mattes, depth: (V, 3, H, W), (V, H, W) and (V, H, W) or None; no gradient.
        cameras: the 21 numbers of each view, one after another.
        softness: (N,) above 0, world units; no gradient.
    """
    out = _empty_samples(xyz, features, images)
    if takes(xyz):
        gpu = load_gpu(xyz.device)
        maps = (dense(images), dense(mattes), _dense(depth), _dense(_rows(features)))
        with gpu.current():
            gpu.kernels.sample_sources(dense(xyz), *maps, cameras, dense(softness), gpu.stream, *out)
        return out
    native().sample_sources(
        as_array(xyz),
        as_array(images),
        as_array(mattes),
        _array(depth),
        _array(_rows(features)),
        cameras,
        as_array(softness),
        thread_count(0, torch.get_num_threads()),
        simd_name(),
        *map(as_array, out),
    )
    return out


@sample.register_fake
def _(
    xyz: Tensor,
    features: Tensor | None,
    images: Tensor,
    mattes: Tensor,
    depth: Tensor | None,
    cameras: list[float],
    softness: Tensor,
) -> tuple[Tensor, Tensor]:
    return _empty_samples(xyz, features, images)


@torch.library.custom_op("fourd::sample_sources_backward", mutates_args=(), device_types=("cpu", "cuda"))
def sample_backward(
    xyz: Tensor,
    features: Tensor | None,
    images: Tensor,
    mattes: Tensor,
    cameras: list[float],
    gradient: Tensor,
    learns: bool,
) -> tuple[Tensor, Tensor]:
    """Gradients of xyz and, where the features learn, of these (else an empty tensor)."""
    grad_xyz, grad_features = _empty_gradients(xyz, features, learns)
    to_features = _rows(grad_features) if learns else None
    if takes(xyz):
        gpu = load_gpu(xyz.device)
        maps = (dense(images), dense(mattes), _dense(_rows(features)))
        with gpu.current():
            gpu.kernels.sample_sources_backward(
                dense(xyz), *maps, cameras, gpu.stream, dense(gradient), grad_xyz, to_features
            )
        return grad_xyz, grad_features
    native().sample_sources_backward(
        as_array(xyz),
        as_array(images),
        as_array(mattes),
        _array(_rows(features)),
        cameras,
        thread_count(0, torch.get_num_threads()),
        simd_name(),
        as_array(gradient),
        as_array(grad_xyz),
        _array(to_features),
    )
    return grad_xyz, grad_features


@sample_backward.register_fake
def _(
    xyz: Tensor,
    features: Tensor | None,
    images: Tensor,
    mattes: Tensor,
    cameras: list[float],
    gradient: Tensor,
    learns: bool,
) -> tuple[Tensor, Tensor]:
    return _empty_gradients(xyz, features, learns)


def _setup(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor]) -> None:
    xyz, features, images, mattes, _, cameras, _ = inputs
    ctx.set_materialize_grads(False)
    ctx.save_for_backward(xyz, features, images, mattes)
    ctx.cameras = cameras


def _backward(
    ctx: Any, gradient: Tensor | None, grad_trust: Tensor | None
) -> tuple[Tensor | None, Tensor | None, None, None, None, None, None]:
    xyz, features, images, mattes = ctx.saved_tensors
    if gradient is None:
        return None, None, None, None, None, None, None
    learns = bool(ctx.needs_input_grad[1])
    grad_xyz, grad_features = sample_backward(xyz, features, images, mattes, ctx.cameras, gradient, learns)
    return grad_xyz, grad_features if learns else None, None, None, None, None, None


sample.register_autograd(_backward, setup_context=_setup)


def _dense(tensor: Tensor | None) -> Tensor | None:
    return None if tensor is None else dense(tensor)


def _array(tensor: Tensor | None) -> Any:
    return None if tensor is None else as_array(tensor)


def _rows(features: Tensor | None) -> Tensor | None:
    """(V, C, h, w) -> (V, h, w, C), the order in memory of torch's channels_last."""
    return None if features is None else features.permute(0, 2, 3, 1)


def _empty_samples(xyz: Tensor, features: Tensor | None, images: Tensor) -> tuple[Tensor, Tensor]:
    views, count = images.shape[0], xyz.shape[0]
    channels = 3 + (0 if features is None else features.shape[1])
    return xyz.new_empty(views, channels, count), xyz.new_empty(views, count)


def _empty_gradients(xyz: Tensor, features: Tensor | None, learns: bool) -> tuple[Tensor, Tensor]:
    grad_xyz = torch.empty_like(xyz, memory_format=torch.contiguous_format)
    if features is None or not learns:
        return grad_xyz, xyz.new_empty(0)
    return grad_xyz, torch.empty_like(features, memory_format=torch.channels_last)
