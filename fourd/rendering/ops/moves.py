"""Updates of points and networks at the end of a training step (``csrc/moves``), in place, for float32 tensors on the
CPU. The callers have the same updates in plain torch, for other devices and dtypes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fourd.base.cameras import Camera
from fourd.rendering.ops.loading import as_array, load_native, thread_count
from fourd.rendering.ops.operator import kernel_array
from fourd.rendering.ops.points.validation import pack_camera

Floats = NDArray[np.float32]


def has_kernels(*tensors: Tensor | slice) -> bool:
    """Return true if the kernels can update these tensors, of which one may be a list of rows."""
    return all(
        isinstance(each, Tensor)
        and each.device.type == "cpu"
        and each.dtype in (torch.float32, torch.int64)
        and each.is_contiguous()
        for each in tensors
    )


def adam_rows(
    rows: Tensor,
    steps: Tensor,
    parameters: Mapping[str, Tensor],
    moments: Mapping[str, Tensor],
    gradients: Mapping[str, Tensor],
    rates: Mapping[str, float | Tensor],
    epsilons: Mapping[str, float],
    betas: tuple[float, float],
) -> None:
    """Count a step for the ``rows`` (M,) of ``steps`` (N,), and update the rows of the parameters (N, C) that have
    gradients (M, C). Components of gradients that are NaN count as 0.

    Args:
        moments: name -> first and second moments (2, N, C).
        rates: name -> one learning rate, or one for each row (M, 1).
        epsilons: name -> Adam's epsilon.
    """
    names = list(gradients)
    load_native().adam_rows(
        kernel_array(rows),
        kernel_array(steps),
        [kernel_array(parameters[name]) for name in names],
        [kernel_array(moments[name]) for name in names],
        [kernel_array(gradients[name]) for name in names],
        [_rates(rates[name]) for name in names],
        [epsilons[name] for name in names],
        *betas,
        _threads(),
    )


def smooth_rows(
    rows: Tensor,
    xyz: Tensor,
    planes: Tensor,
    spacing: Tensor,
    rates: Tensor,
    *,
    strength: float,
    tolerance: float,
    max_share: float,
) -> None:
    """Move the ``rows`` (M,) of ``xyz`` (N, 3) towards their planes (N, 4); see
    :mod:`fourd.reconstruction.training.points.smoothing`, which has the formula and the names."""
    arrays = [kernel_array(each) for each in (rows, xyz, planes, spacing)]
    load_native().smooth_rows(*arrays, as_array(rates).reshape(-1), strength, tolerance, max_share, _threads())


def keep_in_silhouettes(
    rows: Tensor, xyz: Tensor, before: Tensor, views: Sequence[tuple[tuple[Camera, ...], Tensor]]
) -> None:
    """Move the ``rows`` (M,) of ``xyz`` (N, 3) back to ``before`` (M, 3) if they left a silhouette. ``views`` has
    groups of cameras with their mattes (V, H, W)."""
    numbers = [number for cameras, _ in views for camera in cameras for number in pack_camera(camera)]
    mattes = [kernel_array(each) for _, each in views]
    load_native().keep_in_silhouettes(
        kernel_array(rows), kernel_array(xyz), kernel_array(before), mattes, numbers, _threads()
    )


def keep_beyond(rows: Tensor, xyz: Tensor, before: Tensor, camera: Camera, near: float) -> None:
    """Move the ``rows`` (M,) of ``xyz`` (N, 3) back to ``before`` (M, 3) if their depth in ``camera`` is below
    ``near``."""
    arrays = [kernel_array(each) for each in (rows, xyz, before)]
    load_native().keep_beyond(*arrays, camera.forward.tolist(), camera.centre.tolist(), near, _threads())


def add_magnitudes(rows: Tensor, gradient: Tensor, spacing: Tensor, total: Tensor, count: Tensor) -> None:
    """Add the norms of ``gradient`` (M, 3), times the spacings (N,) of the ``rows`` (M,), to ``total`` (N,), and 1 to
    ``count`` (N,) where the norm is not 0."""
    arrays = [kernel_array(each) for each in (rows, gradient, spacing, total, count)]
    load_native().add_magnitudes(*arrays, _threads())


def adam(
    parameters: Sequence[Floats],
    gradients: Sequence[Floats],
    firsts: Sequence[Floats],
    seconds: Sequence[Floats],
    steps: Sequence[int],
    rates: Sequence[float],
    betas: tuple[float, float],
    epsilon: float,
) -> None:
    """Update all parameters, whose first and second moments are given, by Adam. ``steps`` are the numbers of the
    parameters' updates, from 1."""
    sizes = [rate / (1 - betas[0] ** step) for rate, step in zip(rates, steps, strict=True)]
    roots = [(1 - betas[1] ** step) ** 0.5 for step in steps]
    load_native().adam(parameters, gradients, firsts, seconds, sizes, roots, *betas, epsilon, _threads())


def _rates(rate: float | Tensor) -> np.ndarray:
    if isinstance(rate, Tensor):
        return np.asarray(as_array(rate)).reshape(-1)
    return np.array([rate], np.float32)


def _threads() -> int:
    return thread_count(0, torch.get_num_threads())
