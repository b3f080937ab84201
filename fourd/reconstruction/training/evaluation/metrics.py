"""Image metrics: PSNR, SSIM, and the bounding box of a matte."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from fourd.rendering.ops.similarity.reference import check_image_pair, structural_similarity_reference


def psnr(prediction: Tensor | ArrayLike, target: Tensor | ArrayLike, mask: Tensor | ArrayLike | None = None) -> Tensor:
    """Compute the peak signal-to-noise ratio in dB for images with peak value 1. It is infinite for equal images.

    Args:
        prediction: floating-point image (..., C), torch or NumPy.
        target: image of the same shape as ``prediction``.
        mask: bool or nonnegative weights of the pixels, with the shape of ``prediction`` without the last axis; if
            None, all pixels have equal weights.

    Returns:
        A scalar tensor, differentiable in ``prediction``.

    Raises:
        ValueError: the shapes differ, the images are integers (whose peak would be 255 instead of 1), or the mask is
            empty.
    """
    prediction, target = _images(prediction, target)
    squares = (prediction - target).square()
    if mask is None:
        return -10 * torch.log10(squares.mean())
    weights = torch.as_tensor(mask, device=squares.device).to(squares.dtype)
    if weights.shape != squares.shape[:-1]:
        raise ValueError(f"mask: expected shape {tuple(squares.shape[:-1])}, got {tuple(weights.shape)}")
    if float(weights.sum()) <= 0:
        raise ValueError("mask: expected at least one pixel with positive weight, got none")
    mean = (squares * weights[..., None]).sum() / (weights.sum() * squares.shape[-1])
    return -10 * torch.log10(mean)


def ssim(prediction: Tensor | ArrayLike, target: Tensor | ArrayLike) -> Tensor:
    """Compute the structural similarity (Wang et al. 2004) with an 11 x 11 Gaussian window of sigma 1.5, for a data
    range of 1.

    The result is the mean over channels and over the pixels whose window lies inside the image, as in
    ``skimage.metrics.structural_similarity(gaussian_weights=True, sigma=1.5, use_sample_covariance=False)``.

    Args:
        prediction: floating-point image (..., H, W, C), torch or NumPy, where H and W are at least 11 pixels.
        target: image of the same shape as ``prediction``.

    Returns:
        A scalar tensor that is differentiable in both images and is 1 for equal images.

    Raises:
        ValueError: the shapes differ, or the images are integers or smaller than the window.
    """
    return structural_similarity_reference(torch.as_tensor(prediction), torch.as_tensor(target))


def mask_box(mask: NDArray[np.uint8] | NDArray[np.bool_], margin: int = 8) -> tuple[int, int, int, int] | None:
    """Compute the object's bounding box in a matte, extended by ``margin`` pixels on each side and clipped to the
    image.

    Args:
        mask: (H, W) matte, uint8 (255 on the object) or bool. Pixels above 127 belong to the object; this threshold
            prevents faint noise in a soft matte from enlarging the box.
        margin: margin around the object in pixels, 0 or more.

    Returns:
        (top, bottom, left, right) in pixels, where bottom and right are exclusive, or None if no pixel belongs to the
        object.
    """
    if mask.ndim != 2 or mask.dtype not in (np.uint8, np.bool_):
        raise ValueError(f"mask: expected uint8 or bool (H, W), got {mask.dtype} {mask.shape}")
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
    check_image_pair(first, second)
    return first, second
