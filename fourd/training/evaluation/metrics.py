"""Image quality: PSNR, SSIM, and the box of a matte that both are measured in."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor
from torch.nn import functional

SSIM_WINDOW = 11
SSIM_SIGMA = 1.5
SSIM_C1 = 0.01**2
SSIM_C2 = 0.03**2


def psnr(prediction: Tensor | ArrayLike, target: Tensor | ArrayLike, mask: Tensor | ArrayLike | None = None) -> Tensor:
    """Peak signal-to-noise ratio in dB for values with peak 1; infinite for equal images.

    Args:
        prediction, target: (..., C) of the same shape, torch or NumPy, floating point.
        mask: weights (...) that count pixels, bool or nonnegative numbers; all count when None.

    Returns:
        A scalar tensor, differentiable in ``prediction``.

    Raises:
        ValueError: shapes differ, integer images (a peak of 255 would be taken for 1), or an empty mask.
    """
    prediction, target = _images(prediction, target)
    squares = (prediction - target).square()
    if mask is None:
        return -10 * torch.log10(squares.mean())
    weights = torch.as_tensor(mask, device=squares.device).to(squares.dtype)
    if weights.shape != squares.shape[:-1]:
        raise ValueError(f"mask: expected shape {tuple(squares.shape[:-1])}, got {tuple(weights.shape)}")
    if float(weights.sum()) <= 0:
        raise ValueError("mask: expected at least one pixel that counts, got none")
    mean = (squares * weights[..., None]).sum() / (weights.sum() * squares.shape[-1])
    return -10 * torch.log10(mean)


def ssim(prediction: Tensor | ArrayLike, target: Tensor | ArrayLike) -> Tensor:
    """Structural similarity (Wang et al. 2004) with an 11 x 11 Gaussian window of sigma 1.5, data range 1.

    The mean is taken over channels and over the pixels whose window lies in the image, as in
    ``skimage.metrics.structural_similarity(gaussian_weights=True, sigma=1.5, use_sample_covariance=False)``.

    Args:
        prediction, target: (..., H, W, C) of the same shape, torch or NumPy, floating point;
            H and W at least 11 pixels.

    Returns:
        A scalar tensor, differentiable in both, 1 for equal images.

    Raises:
        ValueError: shapes differ, integer images, or an image smaller than the window.
    """
    prediction, target = _images(prediction, target)
    if prediction.ndim < 3 or min(prediction.shape[-3:-1]) < SSIM_WINDOW:
        raise ValueError(
            f"prediction: expected (..., H, W, C) with H and W at least {SSIM_WINDOW} pixels, "
            f"got {tuple(prediction.shape)}"
        )
    x, y = _planes(prediction), _planes(target)
    planes = x.shape[1]
    # The target's two means are filtered apart, so that a loss makes no gradients for them.
    mean_x, square_x, product = _blurred(torch.cat([x, x * x, x * y], dim=1)).split(planes, dim=1)
    mean_y, square_y = _blurred(torch.cat([y, y * y], dim=1)).split(planes, dim=1)
    covariance = product - mean_x * mean_y
    variances = (square_x - mean_x.square()) + (square_y - mean_y.square())
    luminance = (2 * mean_x * mean_y + SSIM_C1) / (mean_x.square() + mean_y.square() + SSIM_C1)
    structure = (2 * covariance + SSIM_C2) / (variances + SSIM_C2)
    return (luminance * structure).mean()


def mask_box(mask: NDArray[np.uint8] | NDArray[np.bool_], margin: int = 8) -> tuple[int, int, int, int] | None:
    """The rectangle round a matte's object, with ``margin`` pixels more on each side, inside the image.

    Args:
        mask: (H, W) uint8 (255 = object) or bool. Pixels above 127 belong to the object, so that
            faint noise of a soft matte does not widen the box.
        margin: pixels, 0 or more.

    Returns:
        (top, bottom, left, right), bottom and right not included; None when nothing belongs to the object.
    """
    if mask.ndim != 2 or mask.dtype not in (np.uint8, np.bool_):
        raise ValueError(f"mask: expected (H, W) of uint8 or bool, got {mask.shape} of {mask.dtype}")
    if margin < 0:
        raise ValueError(f"margin: expected 0 or more pixels, got {margin}")
    inside = mask if mask.dtype == np.bool_ else mask > 127
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if rows.size == 0:
        return None
    height, width = mask.shape
    top, bottom = max(int(rows[0]) - margin, 0), min(int(rows[-1]) + 1 + margin, height)
    left, right = max(int(columns[0]) - margin, 0), min(int(columns[-1]) + 1 + margin, width)
    return top, bottom, left, right


def _images(prediction: Tensor | ArrayLike, target: Tensor | ArrayLike) -> tuple[Tensor, Tensor]:
    first, second = torch.as_tensor(prediction), torch.as_tensor(target)
    if first.shape != second.shape:
        raise ValueError(f"target: expected the prediction's shape {tuple(first.shape)}, got {tuple(second.shape)}")
    if not (first.is_floating_point() and second.is_floating_point()):
        raise ValueError(f"images: expected floating point in [0, 1], got {first.dtype} and {second.dtype}")
    return first, second


def _planes(images: Tensor) -> Tensor:
    """(..., H, W, C) -> (1, B*C, H, W): a channel a plane, so that one grouped filter does all."""
    height, width, channels = images.shape[-3:]
    planes = images.reshape(-1, height, width, channels).permute(0, 3, 1, 2)
    return planes.reshape(1, -1, height, width)


def _blurred(planes: Tensor) -> Tensor:
    """(1, P, H, W) -> (1, P, H-10, W-10), filtered where the window lies in the image."""
    count = planes.shape[1]
    offsets = torch.arange(SSIM_WINDOW, dtype=planes.dtype, device=planes.device) - SSIM_WINDOW // 2
    window = torch.softmax(-offsets.square() / (2 * SSIM_SIGMA**2), dim=0)
    rows = functional.conv2d(planes, window.view(1, 1, 1, -1).expand(count, -1, -1, -1), groups=count)
    return functional.conv2d(rows, window.view(1, 1, -1, 1).expand(count, -1, -1, -1), groups=count)
