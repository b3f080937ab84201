"""The pixel filter's kernels compared with the float reference."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from fourd.rendering.ops.loading import load_native
from fourd.rendering.ops.pixel_filter.cuda import filter_pixels_gpu
from fourd.rendering.ops.pixel_filter.op import filter_pixels
from fourd.rendering.ops.pixel_filter.reference import filter_pixels_reference

SIZES = [(1, 1), (1, 7), (5, 1), (33, 40), (3, 515)]
"""Sizes with one row or column, with several tasks of rows, and with several runs of pixels in a row."""


@pytest.mark.parametrize("simd", ["baseline", "avx2", "avx512"])
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("side", [0.0, 0.1, 0.25])
def test_bytes_equal_the_reference(
    side: float, size: tuple[int, int], simd: str, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a wrong weight, swapped rows and columns, mixed channels, and a wrong pixel beyond the border of the
    image or of a run."""
    if not load_native().simd_available(simd):
        pytest.skip(f"this machine does not run {simd}")
    monkeypatch.setenv("FOURD_SIMD", simd)
    image = rng.integers(0, 256, (*size, 4), dtype=np.uint8)
    expected = filter_pixels_reference(image.astype(np.float32), side)
    for threads in (1, 3):
        got = filter_pixels(image, side, threads=threads)
        assert np.abs(got - expected).max() <= 0.5 + 1e-3


def test_single_pixels_on_a_background(rng: np.random.Generator) -> None:
    """Catches a run or row of equal pixels that is copied without the filter although a neighbouring pixel has a
    different colour.
    """
    for _ in range(50):
        image = np.full((9, 200, 4), rng.integers(0, 256, 4), np.uint8)
        image[rng.integers(9), rng.integers(200)] = rng.integers(0, 256, 4)
        expected = filter_pixels_reference(image.astype(np.float32), 0.1)
        assert np.abs(filter_pixels(image, 0.1) - expected).max() <= 0.5 + 1e-3


@pytest.mark.parametrize("size", SIZES[:4])
def test_bytes_of_the_gpu_equal_the_reference(
    size: tuple[int, int], gpu: torch.device, rng: np.random.Generator
) -> None:
    """Catches a CUDA kernel that reads pixels outside the image, or that filters only rows or only columns."""
    image = rng.integers(0, 256, (*size, 4), dtype=np.uint8)
    got = filter_pixels_gpu(torch.from_numpy(image).to(gpu), 0.1).cpu().numpy()
    assert np.abs(got - filter_pixels_reference(image.astype(np.float32), 0.1)).max() <= 0.5 + 1e-3


def test_the_reference_is_a_weighted_mean_of_nine_pixels() -> None:
    """Catches weights that do not sum to 1, and a filter that is not symmetric."""
    image = np.zeros((5, 6, 3), np.float32)
    image[2, 3] = (1.0, 0.5, 0.0)
    weights = np.outer([0.1, 0.8, 0.1], [0.1, 0.8, 0.1])
    expected = np.zeros_like(image)
    expected[1:4, 2:5] = weights[..., None] * image[2, 3]
    np.testing.assert_allclose(filter_pixels_reference(image, 0.1), expected, atol=1e-6)
    np.testing.assert_allclose(filter_pixels_reference(np.ones((4, 7), np.float32), 0.2), 1, atol=1e-6)


def test_invalid_arguments() -> None:
    """Catches an output that is not checked, or that the kernel overwrites while it still reads it."""
    image = np.zeros((4, 5, 4), np.uint8)
    with pytest.raises(ValueError, match=r"out: expected contiguous uint8 of shape \(4, 5, 4\), got uint8 of shape"):
        filter_pixels(image, 0.1, out=np.zeros((5, 4, 4), np.uint8))
    with pytest.raises(ValueError, match="out: expected memory that does not overlap the image"):
        filter_pixels(image, 0.1, out=image)
    for side in (-0.1, 0.3, np.nan):
        with pytest.raises(ValueError, match=r"side: expected a weight from 0 to 0\.25"):
            filter_pixels(image, side)
