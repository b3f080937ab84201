"""Interpolation of vertex attributes over rasterized triangles: :func:`interpolate`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from fourd.rendering.ops.interpolate.op import interpolate_attributes
from fourd.rendering.ops.interpolate.reference import interpolate_attributes_reference
from fourd.rendering.ops.meshes.backends import select_backend
from fourd.rendering.ops.meshes.checks import check_tensor, check_triangles


def interpolate(
    attr: Tensor,
    rast: Tensor,
    tri: Tensor,
    rast_db: Tensor | None = None,
    diff_attrs: Literal["all"] | Sequence[int] | None = None,
    *,
    backend: str = "auto",
    threads: int = 0,
) -> tuple[Tensor, Tensor]:
    """Interpolate vertex attributes at each pixel of the images ``rast`` that
    :func:`fourd.rendering.triangles.rasterize` has returned.

    The value at a pixel is ``u * a_0 + v * a_1 + (1 - u - v) * a_2``, where a_k are the attributes of the vertices of
    the pixel's triangle.

    Args:
        attr: float32 attributes of the vertices, with C of at least 1: (B, V, C) with separate attributes for each of
            the B images, or (1, V, C) or (V, C) with attributes that all images share.
        rast: (B, H, W, 4) result of ``rasterize``.
        tri: (T, 3) int32 vertex indices of the triangles.
        rast_db: (B, H, W, 4) derivatives from ``rasterize``, required if ``diff_attrs`` selects channels, and otherwise
            ignored.
        diff_attrs: channels whose derivatives are computed: a list (negative indices count from the end), or "all".
        backend: see ``rasterize``.
        threads: see ``rasterize``.

    Returns:
        The values ``out`` (B, H, W, C), and for D channels in ``diff_attrs`` the derivatives ``out_da``
        (B, H, W, 2 * D) with respect to the pixel position (X, Y), where X increases with the column, and Y with the
        row. Their order is d0/dX, d0/dY, d1/dX, d1/dY and so on, where 0 and 1 are the first two channels in
        ``diff_attrs``. Pixels that show no triangle, or a triangle with index T or more, have the value 0.

        ``out`` is differentiable in ``attr`` and in u and v of ``rast``, and ``out_da`` in ``attr`` and ``rast_db``.
        Second derivatives are not supported. On the CPU, gradients are bit-identical for any number of threads.

    Raises:
        TypeError, ValueError: for an invalid argument. The error message names the argument and the expected value.
        RuntimeError: if ``backend`` needs CUDA kernels that were not built.
    """
    attributes = _check_attributes(attr)
    like = ("attr", attributes)
    check_tensor("rast", rast, ("B", "H", "W", 4), like=like)
    if attributes.shape[0] not in (1, rast.shape[0]):
        raise ValueError(f"attr: expected 1 or {rast.shape[0]} meshes, as rast has images, got {attributes.shape[0]}")
    tri = check_triangles(tri, attributes.shape[1], like, check_values=attributes.device.type == "cpu")
    diff = _channels(diff_attrs, attributes.shape[2])
    if rast_db is not None and diff:
        check_tensor("rast_db", rast_db, tuple(rast.shape), like=like)
    if diff and rast_db is None:
        raise ValueError("rast_db: expected the derivatives from rasterize, because diff_attrs is not empty, got None")
    chosen_db = rast_db if diff else None
    if select_backend(backend, "attr", attributes) == "reference":
        return interpolate_attributes_reference(attributes, rast, tri, chosen_db, diff)
    return interpolate_attributes(attributes, rast, tri, chosen_db, diff, threads)


def _check_attributes(attr: object) -> Tensor:
    """Check the attributes, and return them as a tensor (B, V, C), or (1, V, C) if all images share them."""
    is_shared = isinstance(attr, Tensor) and attr.ndim == 2
    shape = ("V", "C") if is_shared else ("B", "V", "C")
    attributes = check_tensor("attr", attr, shape, dtypes=(torch.float32, torch.float64))
    if attributes.shape[-1] == 0:
        raise ValueError(f"attr: expected at least 1 channel, got shape {tuple(attributes.shape)}")
    return attributes[None] if is_shared else attributes


def _channels(diff_attrs: Literal["all"] | Sequence[int] | None, channels: int) -> list[int]:
    """Return the channels whose derivatives are computed, as indices from 0."""
    if diff_attrs is None:
        return []
    if isinstance(diff_attrs, str):
        if diff_attrs != "all":
            raise ValueError(f"diff_attrs: expected a list of channels or 'all', got {diff_attrs!r}")
        return list(range(channels))
    chosen = []
    for channel in diff_attrs:
        if isinstance(channel, bool) or not isinstance(channel, int | np.integer):
            raise TypeError(f"diff_attrs: expected integers, got {channel!r}")
        if not -channels <= channel < channels:
            raise ValueError(f"diff_attrs: expected channels from {-channels} to {channels - 1}, got {channel}")
        chosen.append(int(channel) % channels)
    return chosen
