"""Bilinear sampling of feature planes in plain torch."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn import functional


def sample_planes_reference(coordinates: Tensor, planes: Sequence[Tensor], axes: Sequence[int]) -> Tensor:
    """Compute the result of :func:`fourd.rendering.ops.planes.op.sample_planes` on any device, in float32 or
    float64."""
    samples = []
    for k, plane in enumerate(planes):
        column, row = coordinates[:, axes[2 * k]], coordinates[:, axes[2 * k + 1]]
        grid = torch.stack((column, row), dim=1).nan_to_num(nan=-1.0).reshape(1, 1, -1, 2)
        values = plane.permute(2, 0, 1)[None]
        found = functional.grid_sample(values, grid, align_corners=True, padding_mode="border")
        samples.append(found[0, :, 0].T)
    return torch.cat(samples, dim=1)
