"""Encodes triangle ids as values of a float32 image. ``csrc/common/triangle_id.h`` has the same functions for the
kernels.

The value 0 is the background. The triangle with index i is stored as the number n = i + 1: as the float n if n is at
most 2^24, and otherwise as the float with the bit pattern 0x4a800000 + n, because float32 cannot represent every
integer above 2^24.
"""

from __future__ import annotations

import torch
from torch import Tensor

NO_TRIANGLE = -1
_EXACT_IDS = 2**24
_ID_BITS = 0x4A800000
MAX_TRIANGLES = 0x7F800000 - _ID_BITS - 1
"""Maximum number of triangles. With more triangles, some pixel values that encode ids would be infinite or NaN."""


def encode_ids(triangle: Tensor) -> Tensor:
    """Encode triangle indices, given as an integer tensor of any shape, as float32 pixel values. The index -1 is the
    background.

    The function is not differentiable.
    """
    number = (triangle + 1).to(torch.int32)
    return torch.where(number <= _EXACT_IDS, number.to(torch.float32), (number + _ID_BITS).view(torch.float32))


def decode_ids(value: Tensor) -> Tensor:
    """Decode float32 or float64 pixel values, given as a tensor of any shape, to int32 triangle indices.

    The index is -1 where the value is 0, negative or NaN. The function is not differentiable.
    """
    value = value.detach().to(torch.float32).contiguous()
    exact = torch.nan_to_num(value).clamp(0, _EXACT_IDS).to(torch.int32)
    number = torch.where(value <= _EXACT_IDS, exact, value.view(torch.int32) - _ID_BITS)
    return torch.where(value >= 1, number - 1, torch.full_like(number, NO_TRIANGLE))
