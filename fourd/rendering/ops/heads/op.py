"""The networks of the point model: the operator ``torch.ops.fourd.evaluate_heads`` and its gradient."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from fourd.rendering.ops.heads.layers import NO_TIME_PLANES, HeadSettings, HeadWeights, TimePlanes
from fourd.rendering.ops.heads.reference import evaluate_heads_reference
from fourd.rendering.ops.loading import load_native, simd_name, thread_count
from fourd.rendering.ops.operator import kernel_array, operator, uninitialised

SH_COEFFICIENTS = 48
PADDING = 16
MAX_HIDDEN = 512
MAX_TIME_SAMPLES = 2048
"""Maximum number of samples along the coordinates of all time planes together. Each task of the kernel sums gradients
of all samples, so more samples could need more memory than the features that they replace."""
Points = tuple[Tensor, Tensor, Tensor, Tensor, Tensor | None, Tensor, Tensor]
Planes = tuple[list[Tensor], list[int], list[int], Tensor | None, float]


def has_heads_kernel(points: Tensor, hidden: int) -> bool:
    """Return true if the kernel computes :func:`evaluate_heads` for layers of width ``hidden``, on the device and in
    the dtype of the tensor ``points``. The kernel computes float32 values on the CPU."""
    return points.device.type == "cpu" and points.dtype == torch.float32 and hidden <= MAX_HIDDEN


def evaluate_heads(
    features: Tensor,
    samples: Tensor,
    visibility: Tensor,
    view_weights: Tensor,
    own: Tensor | None,
    xyz: Tensor,
    spacing: Tensor,
    weights: HeadWeights,
    settings: HeadSettings,
    time_planes: TimePlanes = NO_TIME_PLANES,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Compute radius, density, SH coefficients and colour of N points from their features and their samples in V source
    views.

    The layers and the formulas are those of the modules in :mod:`fourd.reconstruction.model`; the reference has them in
    one place. Where :func:`has_heads_kernel` is false, the reference computes the result.

    Args:
        features: (N, F) K-Planes features, without those of ``time_planes``.
        samples: (V, C, N) image features and, as the last three channels, RGB of each view at each point's projection.
        visibility: (V, N) visibility weights in [0, 1]. Not differentiable.
        view_weights: (V,) weights of the views in [0, 1], of which at least one is positive. Not differentiable.
        own: (N, 3) own colours of the points, or None.
        xyz: (N, 3) positions in world units, which determine the viewing directions of the SH.
        spacing: (N,) distances between neighbouring points in world units. Not differentiable.
        weights: the weights of the layers.
        settings: the constants of the networks.
        time_planes: planes from which further inputs of the first layers are sampled. The kernel samples the outputs of
            the layers instead, which takes less time and differs by rounding errors. Their coordinates are not
            differentiable.

    Returns:
        radii (N,) in world units, densities (N,), SH coefficients (N, 48), and colours (N, 3). They are differentiable
        in all other arguments, once. The gradient is bit-identical for any number of threads.

    Raises:
        ValueError: if shapes do not match.
    """
    if not has_heads_kernel(features, weights.geometry_first_bias.shape[0]):
        return evaluate_heads_reference(
            features, samples, visibility, view_weights, own, xyz, spacing, weights, settings, time_planes
        )
    points = (features, samples, visibility, view_weights, own, xyz, spacing)
    planes = time_planes.planes, time_planes.axes, time_planes.columns, time_planes.coordinates, time_planes.time
    radius, density, sh, colour, _ = _evaluate(*points, *planes, weights.tensors, settings.numbers)
    return radius, density, sh, colour


def _empty_outputs(
    features: Tensor, samples: Tensor, weights: list[Tensor]
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    count, hidden = features.shape[0], -(-weights[1].shape[0] // PADDING) * PADDING
    saved_size = count * (4 * hidden + samples.shape[0])
    shapes = ((count,), (count,), (count, SH_COEFFICIENTS), (count, 3), (saved_size,))
    radius, density, sh, colour, saved = (uninitialised(features, *shape) for shape in shapes)
    return radius, density, sh, colour, saved


def _arguments(points: Points, time_planes: Planes, weights: list[Tensor], settings: list[float]) -> list[Any]:
    arrays = [None if each is None else kernel_array(each) for each in points]
    planes, axes, columns, coordinates, time = time_planes
    places = None if coordinates is None else kernel_array(coordinates)
    lines = [[kernel_array(plane) for plane in planes], axes, columns, places, time]
    threads = thread_count(0, torch.get_num_threads())
    return [*arrays, *lines, [kernel_array(weight) for weight in weights], settings, threads, simd_name()]


@operator("fourd::evaluate_heads", outputs=_empty_outputs, devices=("cpu",))
def _evaluate(
    features: Tensor,
    samples: Tensor,
    visibility: Tensor,
    view_weights: Tensor,
    own: Tensor | None,
    xyz: Tensor,
    spacing: Tensor,
    planes: list[Tensor],
    axes: list[int],
    columns: list[int],
    coordinates: Tensor | None,
    time: float,
    weights: list[Tensor],
    settings: list[float],
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
    """Compute radius, density, SH, colour, and what the gradient needs: the hidden layers and the blend logits."""
    out = _empty_outputs(features, samples, weights)
    points = (features, samples, visibility, view_weights, own, xyz, spacing)
    arguments = _arguments(points, (planes, axes, columns, coordinates, time), weights, settings)
    load_native().evaluate_heads(*arguments, *(kernel_array(each) for each in out))
    return out


def _empty_gradients(
    features: Tensor,
    samples: Tensor,
    own: Tensor | None,
    xyz: Tensor,
    planes: list[Tensor],
    weights: list[Tensor],
) -> tuple[Tensor, Tensor, Tensor, Tensor, list[Tensor], list[Tensor]]:
    own_shape = (0, 3) if own is None else own.shape
    shapes = (features.shape, samples.shape, own_shape, xyz.shape)
    to_features, to_samples, to_own, to_xyz = (uninitialised(features, *shape) for shape in shapes)
    to_planes, to_weights = ([uninitialised(each, *each.shape) for each in arrays] for arrays in (planes, weights))
    return to_features, to_samples, to_own, to_xyz, to_planes, to_weights


@operator("fourd::evaluate_heads_backward", outputs=_empty_gradients, devices=("cpu",))
def _evaluate_backward(
    features: Tensor,
    samples: Tensor,
    visibility: Tensor,
    view_weights: Tensor,
    own: Tensor | None,
    xyz: Tensor,
    spacing: Tensor,
    planes: list[Tensor],
    axes: list[int],
    columns: list[int],
    coordinates: Tensor | None,
    time: float,
    weights: list[Tensor],
    settings: list[float],
    grad_radius: Tensor,
    grad_density: Tensor,
    grad_sh: Tensor | None,
    grad_colour: Tensor,
    sh: Tensor,
    saved: Tensor,
) -> tuple[Tensor, Tensor, Tensor, Tensor, list[Tensor], list[Tensor]]:
    """Compute the gradients of features, samples, own colours, positions, time planes and weights. Without own colours,
    their gradient has no rows."""
    out = _empty_gradients(features, samples, own, xyz, planes, weights)
    points = (features, samples, visibility, view_weights, own, xyz, spacing)
    load_native().evaluate_heads_backward(
        *_arguments(points, (planes, axes, columns, coordinates, time), weights, settings),
        kernel_array(grad_radius),
        kernel_array(grad_density),
        None if grad_sh is None else kernel_array(grad_sh),
        kernel_array(grad_colour),
        kernel_array(sh),
        kernel_array(saved),
        kernel_array(out[0]),
        kernel_array(out[1]),
        None if own is None else kernel_array(out[2]),
        kernel_array(out[3]),
        [kernel_array(plane) for plane in out[4]],
        [kernel_array(weight) for weight in out[5]],
    )
    return out


def _setup(ctx: Any, inputs: tuple[Any, ...], output: tuple[Tensor, Tensor, Tensor, Tensor, Tensor]) -> None:
    features, samples, visibility, view_weights, own, xyz, spacing, *time_planes, weights, settings = inputs
    planes, ctx.axes, ctx.columns, coordinates, ctx.time = time_planes
    ctx.set_materialize_grads(False)
    ctx.mark_non_differentiable(output[4])
    points = (features, samples, visibility, view_weights, xyz, spacing)
    ctx.save_for_backward(*points, output[2], output[4], own, coordinates, *planes, *weights)
    ctx.settings = settings


def _backward(
    ctx: Any,
    grad_radius: Tensor | None,
    grad_density: Tensor | None,
    grad_sh: Tensor | None,
    grad_colour: Tensor | None,
    _: Tensor | None,
) -> tuple[Any, ...]:
    features, samples, visibility, view_weights, xyz, spacing, sh, saved, own, coordinates, *rest = ctx.saved_tensors
    planes, weights = rest[: len(ctx.axes)], rest[len(ctx.axes) :]
    upstream = [
        torch.zeros_like(spacing) if grad_radius is None else grad_radius,
        torch.zeros_like(spacing) if grad_density is None else grad_density,
        grad_sh,
        torch.zeros_like(xyz) if grad_colour is None else grad_colour,
    ]
    points = (features, samples, visibility, view_weights, own, xyz, spacing)
    time_planes = (planes, ctx.axes, ctx.columns, coordinates, ctx.time)
    to_features, to_samples, to_own, to_xyz, to_planes, to_weights = _evaluate_backward(
        *points, *time_planes, weights, ctx.settings, *upstream, sh, saved
    )
    to_points = (to_features, to_samples, None, None, None if own is None else to_own, to_xyz, None)
    to_indices: list[Tensor] | None = None if ctx.axes else []  # torch takes an empty list for one of tensors.
    return *to_points, to_planes, to_indices, to_indices, None, None, to_weights, None


_evaluate.register_autograd(_backward, setup_context=_setup)
