"""Triangle ids as values of a float32 image. ``csrc/common/triangle_id.h`` has the same functions for the kernels.

The value 0 is the background. The triangle with the index i is stored as the integer n = i + 1. If n is at most 2^24,
the pixel has the value n. Above 2^24, float32 cannot represent every integer, so n is stored as the float with the bit
pattern 0x4a800000 + n.
"""

from __future__ import annotations

import torch
from torch import Tensor

NO_TRIANGLE = -1
_EXACT_IDS = 2**24
_ID_BITS = 0x4A800000
MAX_TRIANGLES = 0x7F800000 - _ID_BITS - 1
"""Largest number of triangles. With more triangles, some ids would have pixel values that are infinite or NaN."""


def encode_ids(triangle: Tensor) -> Tensor:
    """Return the float32 pixel values of integer triangle indices of any shape. -1 means background.

    Not differentiable.
    """
    number = (triangle + 1).to(torch.int32)
    return torch.where(number <= _EXACT_IDS, number.to(torch.float32), (number + _ID_BITS).view(torch.float32))


def decode_ids(value: Tensor) -> Tensor:
    """Return the int32 triangle indices of pixel values of any shape and of dtype float32 or float64.

    The index is -1 where the value is 0, negative or NaN. The function is not differentiable.
    """
    value = value.detach().to(torch.float32).contiguous()
    exact = torch.nan_to_num(value).clamp(0, _EXACT_IDS).to(torch.int32)
    number = torch.where(value <= _EXACT_IDS, exact, value.view(torch.int32) - _ID_BITS)
    return torch.where(value >= 1, number - 1, torch.full_like(number, NO_TRIANGLE))
