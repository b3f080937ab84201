"""Arrays that start at a cache line or at a huge page."""

from __future__ import annotations

import numpy as np
import pytest

from fourd.rendering.ops.aligned import CACHE_LINE, HUGE_PAGE, zeros_aligned


@pytest.mark.parametrize(
    ("shape", "alignment"),
    [
        ((3, 5), CACHE_LINE),
        ((HUGE_PAGE // 4 - 1,), CACHE_LINE),
        ((HUGE_PAGE // 4,), HUGE_PAGE),
        ((1080, 1920), HUGE_PAGE),
    ],
)
def test_arrays_start_at_their_alignment(shape: tuple[int, ...], alignment: int) -> None:
    """Catches large arrays that share their first huge page with other data, and arrays without their last elements."""
    array = zeros_aligned(shape, np.float32)
    assert array.ctypes.data % alignment == 0
    assert array.shape == shape
    assert array.dtype == np.float32
    assert array.flags.c_contiguous
    assert not array.any()
    array.fill(1.0)
    assert array.sum(dtype=np.float64) == array.size


def test_empty_arrays_are_possible() -> None:
    """Catches a division by zero in the size of an image without pixels."""
    assert zeros_aligned((0, 4), np.uint8).shape == (0, 4)
