"""Multi-resolution hash encoding in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor

from fourd.rendering.ops.hashgrid.shape import HashGridShape, check_hash_grid

PRIMES = (1, 2654435761, 805459861)  # Mueller et al. 2022, eq. 4


def encode_hash_grid_reference(coordinates: Tensor, table: Tensor, shape: HashGridShape) -> Tensor:
    """Compute the result of :func:`fourd.rendering.ops.hashgrid.op.encode_hash_grid` on any device, in float32 or
    float64."""
    check_hash_grid(coordinates, table, shape)
    positions = coordinates.nan_to_num(nan=0.0).clamp(0, 1)
    levels = zip(shape.resolutions, shape.entries, shape.offsets, strict=True)
    return torch.cat([_level(positions, table[offset : offset + count], side) for side, count, offset in levels], dim=1)


def _level(positions: Tensor, values: Tensor, resolution: int) -> Tensor:
    """Interpolate the stored values (E, F) of one level at positions (N, 3) in [0, 1]. Return (N, F)."""
    scaled = positions * resolution
    low = scaled.detach().long().clamp(max=resolution - 1)
    fraction = scaled - low
    corners = []
    for corner in range(8):
        offset = torch.tensor([corner & 1, corner >> 1 & 1, corner >> 2], device=positions.device)
        weight = torch.where(offset.bool(), fraction, 1 - fraction).prod(dim=1, keepdim=True)
        corners.append(weight * values[_entry_index(low + offset, resolution, len(values))])
    return torch.stack(corners).sum(dim=0)


def _entry_index(sample: Tensor, resolution: int, entries: int) -> Tensor:
    """Return the row (N,) of each sample in the table of a level, which has ``entries`` rows. A sample is a corner of
    the level's cells, given by its integer grid coordinates (N, 3)."""
    x, y, z = sample.unbind(dim=1)
    side = resolution + 1
    if side**3 <= entries:
        return x + y * side + z * side**2
    # ``entries`` is a power of two of at most 2^24, so the mask ``entries - 1`` keeps at most the 24 lowest bits, which
    # are equal in a 64-bit product and a 32-bit product.
    return (x * PRIMES[0] ^ y * PRIMES[1] ^ z * PRIMES[2]) & (entries - 1)
