"""Interpolation of vertex attributes in plain torch: slow, but simple, and differentiable through autograd."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from fourd.rendering.ops.meshes.ids import decode_ids


def interpolate_attributes_reference(
    attr: Tensor, rast: Tensor, tri: Tensor, rast_db: Tensor | None, diff: Sequence[int]
) -> tuple[Tensor, Tensor]:
    """Compute the result of :func:`fourd.rendering.ops.interpolate.op.interpolate_attributes`, in float32 or
    float64."""
    triangle = decode_ids(rast[..., 3]).long()
    is_hit = (triangle >= 0) & (triangle < tri.shape[0])
    image, row, column = is_hit.nonzero(as_tuple=True)
    out = attr.new_zeros(*rast.shape[:3], attr.shape[2])
    out_da = attr.new_zeros(*rast.shape[:3], 2 * len(diff))
    vertices = tri.long()[triangle[is_hit]]
    a0, a1, a2 = attr[(image if attr.shape[0] > 1 else torch.zeros_like(image))[:, None], vertices].unbind(1)
    u, v = rast[is_hit][:, 0:1], rast[is_hit][:, 1:2]
    out = out.index_put((image, row, column), (u * a0 + v * a1) + ((1 - u) - v) * a2)
    if rast_db is None or len(diff) == 0:
        return out, out_da
    channels = list(diff)
    along_u, along_v = (a0 - a2)[:, channels, None], (a1 - a2)[:, channels, None]
    db = rast_db[is_hit]
    slopes = db[:, None, 0:2] * along_u + db[:, None, 2:4] * along_v
    return out, out_da.index_put((image, row, column), slopes.flatten(1))
