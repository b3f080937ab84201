"""Accepts the arguments that ``nvdiffrast.torch`` accepts, but :mod:`fourd.rendering.triangles` does not.

nvdiffrast ignores some arguments that it does not use, and skips triangles with a vertex index out of range. A script
must not fail here because of them. Python shows each of the warnings once per line of the calling script.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from fourd.rendering.ops.meshes.ids import decode_ids


def usable_triangles(tri: Tensor, vertices: int, depth: int = 3) -> tuple[Tensor, Tensor | None]:
    """Replace triangles with a vertex index out of range by (0, 0, 0), which covers no pixel and has no neighbours.

    Return the triangles (T, 3), and a mask (T,) of those that were replaced, or None if there are none. On a GPU,
    nothing is replaced, because the check would have to wait for the GPU; the kernels skip these triangles. ``depth``
    is the number of stack frames from here to the calling script.
    """
    if not isinstance(tri, Tensor) or tri.device.type != "cpu" or tri.dtype != torch.int32 or tri.ndim != 2:
        return tri, None
    indices = tri.numpy()
    if indices.size == 0 or (indices.min() >= 0 and indices.max() < vertices):
        return tri, None
    wrong = torch.from_numpy(((indices < 0) | (indices >= vertices)).any(axis=1))
    found = f"{int(wrong.sum())} of {len(tri)} triangles have a vertex index outside 0 to {vertices - 1}"
    warnings.warn(f"tri: {found} and are skipped", stacklevel=depth)
    return torch.where(wrong[:, None], torch.zeros_like(tri), tri), wrong


def mesh(pos: Tensor, tri: Tensor, ranges: Tensor | None) -> tuple[Tensor, Tensor | None]:
    """Return the usable triangles, and ``ranges`` if ``pos`` (V, 4) has no images of its own."""
    if not isinstance(pos, Tensor) or pos.ndim < 2:
        return tri, ranges
    if ranges is not None and pos.ndim == 3:
        warnings.warn("ranges: ignored, because pos (B, V, 4) has one mesh for each image", stacklevel=3)
        ranges = None
    return usable_triangles(tri, pos.shape[-2], 4)[0], ranges


def shown_triangles(attr: Tensor, rast: Tensor, tri: Tensor) -> tuple[Tensor, Tensor]:
    """Return the usable triangles, and ``rast`` in which pixels that show other triangles are background."""
    tri, wrong = usable_triangles(tri, attr.shape[-2], 4)
    if wrong is None:
        return tri, rast
    ids = decode_ids(rast[..., 3]).long()
    is_wrong = (ids >= 0) & (ids < len(tri)) & wrong[ids.clamp(0, len(tri) - 1)]
    return tri, torch.where(is_wrong[..., None], torch.zeros_like(rast), rast)


def channels(diff_attrs: object, attr: Tensor) -> list[int]:
    """Return the channels of ``diff_attrs``, which may lie outside those of ``attr``."""
    if diff_attrs is None:
        return []
    if isinstance(diff_attrs, str) and diff_attrs == "all":
        return list(range(attr.shape[-1]))
    try:
        chosen = np.asarray(diff_attrs).astype(np.int32)
    except (TypeError, ValueError) as error:
        raise TypeError(f"diff_attrs: expected a list of channels or 'all', got {diff_attrs!r}") from error
    if chosen.ndim != 1:
        raise ValueError(f"diff_attrs: expected a list of channels, got an array of shape {chosen.shape}")
    count = attr.shape[-1]
    beyond = sorted({int(channel) for channel in chosen if not -count <= channel < count})
    if beyond:
        warnings.warn(
            f"diff_attrs: attr has {count} channels; the derivatives of {', '.join(map(str, beyond))} are 0",
            stacklevel=3,
        )
    return [int(channel) for channel in chosen]


def spread(out_da: Tensor, wanted: Sequence[int], known: Sequence[int]) -> Tensor:
    """Insert derivatives of 0 for the channels ``wanted`` that are not in ``known``, the channels of ``out_da``."""
    if len(wanted) == len(known):
        return out_da
    positions = [position for position, channel in enumerate(wanted) if channel in known]
    at = torch.tensor(positions, device=out_da.device, dtype=torch.long)
    out = out_da.new_zeros(*out_da.shape[:3], len(wanted), 2)
    return out.index_copy(3, at, out_da.unflatten(-1, (len(known), 2))).flatten(3)


def level_inputs(
    filter_mode: str, uv_da: Tensor | None, bias: Tensor | None
) -> tuple[str, Tensor | None, Tensor | None]:
    """Return the filter mode, with "auto" replaced by the mode that it stands for, and the two inputs of the mip level
    that this mode uses. An empty tensor counts as None if the other input exists."""
    if filter_mode == "auto":
        filter_mode = "linear" if uv_da is None and bias is None else "linear-mipmap-linear"
    if "mipmap" not in filter_mode:
        return filter_mode, None, None
    has_uv_da, has_bias = (value is not None and value.numel() > 0 for value in (uv_da, bias))
    if has_bias and not has_uv_da:
        return filter_mode, None, bias
    if has_uv_da and not has_bias:
        return filter_mode, uv_da, None
    return filter_mode, uv_da, bias
