"""PSNR, SSIM and bounding boxes compared with skimage, NumPy and finite differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from fourd.reconstruction.training.evaluation.metrics import mask_box, psnr, ssim


def pair(rng: np.random.Generator, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """A float64 image with structure, and a noisy copy of the image."""
    ramp = np.linspace(0, 1, shape[-2])[:, None] * np.ones(shape[-1])
    first = np.clip(0.5 * rng.random(shape) + 0.5 * ramp, 0, 1)
    return first, np.clip(first + rng.normal(0, 0.1, shape), 0, 1)


def test_psnr_equals_skimage(rng: np.random.Generator) -> None:
    """Catches a PSNR from the root mean square error, from a natural logarithm, or from a mean over the PSNR of the
    channels."""
    first, second = pair(rng, (13, 17, 3))
    assert float(psnr(second, first)) == pytest.approx(peak_signal_noise_ratio(first, second, data_range=1), rel=1e-9)
    assert math.isinf(float(psnr(first, first)))


def test_psnr_is_over_masked_pixels_alone(rng: np.random.Generator) -> None:
    """Catches a masked PSNR that is divided by the number of all pixels, or by the number of pixels instead of colour
    values."""
    first, second = pair(rng, (13, 17, 3))
    mask = rng.random((13, 17)) < 0.4
    mask[3, 4] = True
    expected = peak_signal_noise_ratio(first[mask], second[mask], data_range=1)
    assert float(psnr(second, first, mask)) == pytest.approx(expected, rel=1e-9)
    weights = torch.from_numpy(mask).float() * 0.25
    assert float(psnr(torch.from_numpy(second), torch.from_numpy(first), weights)) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("shape", [(11, 11, 3), (40, 27, 3), (31, 64, 1)])
def test_ssim_equals_skimage(shape: tuple[int, int, int], rng: np.random.Generator) -> None:
    """Catches an SSIM with a wrong window, sigma, covariance or border, or with swapped axes."""
    first, second = pair(rng, shape)
    expected = structural_similarity(
        first, second, gaussian_weights=True, sigma=1.5, use_sample_covariance=False, data_range=1, channel_axis=2
    )
    assert float(ssim(second, first)) == pytest.approx(expected, abs=1e-9)
    single = ssim(torch.from_numpy(second).float(), torch.from_numpy(first).float())
    assert float(single) == pytest.approx(expected, abs=1e-5)
    assert float(ssim(first, first)) == pytest.approx(1, abs=1e-12)


def test_ssim_of_a_batch_is_the_mean(rng: np.random.Generator) -> None:
    """Catches an SSIM of a batch that mixes pixels of different images."""
    first, second = pair(rng, (4, 19, 23, 3))
    separate = np.mean([float(ssim(a, b)) for a, b in zip(first, second, strict=True)])
    assert float(ssim(first, second)) == pytest.approx(separate, abs=1e-9)


def test_gradients_equal_finite_differences(rng: np.random.Generator) -> None:
    """Catches a PSNR or SSIM without a gradient. Both metrics are used as losses."""
    first, second = (torch.from_numpy(image) for image in pair(rng, (12, 13, 2)))
    weights = torch.from_numpy(rng.random((12, 13)))
    assert torch.autograd.gradcheck(lambda image: ssim(image, second), first.clone().requires_grad_())
    assert torch.autograd.gradcheck(lambda image: ssim(second, image), first.clone().requires_grad_())
    assert torch.autograd.gradcheck(lambda image: psnr(image, second, weights), first.clone().requires_grad_())


def test_invalid_images_are_refused() -> None:
    """Catches metrics that accept images with values up to 255, or images of different shapes that broadcast."""
    image = np.zeros((20, 20, 3))
    with pytest.raises(ValueError, match="floating-point"):
        psnr(image.astype(np.uint8), image.astype(np.uint8))
    with pytest.raises(ValueError, match="prediction's shape"):
        ssim(image, image[:, :1])
    with pytest.raises(ValueError, match="at least 11"):
        ssim(image[:10], image[:10])
    with pytest.raises(ValueError, match="mask: expected shape"):
        psnr(image, image, np.ones((20, 1)))
    with pytest.raises(ValueError, match="at least one pixel"):
        psnr(image, image, np.zeros((20, 20)))


def test_mask_box_extends_its_margin_within_the_image() -> None:
    """Catches a box that omits the last row of the mask, has swapped axes, or extends beyond the image border."""
    mask = np.zeros((50, 80), dtype=np.uint8)
    mask[20:24, 30:41] = 255
    assert mask_box(mask, margin=0) == (20, 24, 30, 41)
    assert mask_box(mask) == (12, 32, 22, 49)
    assert mask_box(mask, margin=25) == (0, 49, 5, 66)
    assert mask_box(mask, margin=1000) == (0, 50, 0, 80)
    assert mask_box(mask > 0, margin=0) == (20, 24, 30, 41)


def test_mask_box_ignores_noise_and_empty_masks() -> None:
    """Catches a box around a mask that a single noisy pixel enlarges."""
    mask = np.zeros((50, 80), dtype=np.uint8)
    mask[0, 0] = 127
    assert mask_box(mask) is None
    mask[10, 70] = 128
    assert mask_box(mask, margin=0) == (10, 11, 70, 71)
    with pytest.raises(ValueError, match="uint8 or bool"):
        mask_box(mask.astype(np.float32))
    with pytest.raises(ValueError, match="margin"):
        mask_box(mask, margin=-1)
