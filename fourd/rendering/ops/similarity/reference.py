"""Structural similarity in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

WINDOW_PX = 11
SIGMA_PX = 1.5
C1 = 0.01**2
C2 = 0.03**2


def structural_similarity_reference(prediction: Tensor, target: Tensor) -> Tensor:
    """Compute SSIM (Wang et al. 2004) with an 11 x 11 Gaussian window of standard deviation 1.5 and data range 1.

    The result is the mean over channels and over the pixels whose window is entirely inside the image, as in
    ``skimage.metrics.structural_similarity(gaussian_weights=True, sigma=1.5, use_sample_covariance=False)``.

    Args:
        prediction, target: floating-point images (..., H, W, C) of equal shape; H and W are at least 11 pixels.

    Returns:
        The similarity as a scalar, which is 1 for equal images and differentiable in both images.

    Raises:
        ValueError: for different shapes, integer images, or an image smaller than the window.
    """
    check_image_pair(prediction, target)
    if prediction.ndim < 3 or min(prediction.shape[-3:-1]) < WINDOW_PX:
        raise ValueError(
            f"prediction: expected (..., H, W, C) with H and W at least {WINDOW_PX} pixels, "
            f"got {tuple(prediction.shape)}"
        )
    x, y = _to_planes(prediction), _to_planes(target)
    planes = x.shape[1]
    # The window means of y and y * y are computed in a separate call of _blur, which the backward pass skips because
    # the target of a loss needs no gradient.
    mean_x, square_x, product = _blur(torch.cat([x, x * x, x * y], dim=1)).split(planes, dim=1)
    mean_y, square_y = _blur(torch.cat([y, y * y], dim=1)).split(planes, dim=1)
    covariance = product - mean_x * mean_y
    variances = (square_x - mean_x.square()) + (square_y - mean_y.square())
    luminance = (2 * mean_x * mean_y + C1) / (mean_x.square() + mean_y.square() + C1)
    structure = (2 * covariance + C2) / (variances + C2)
    return (luminance * structure).mean()


def check_image_pair(prediction: Tensor, target: Tensor) -> None:
    """Raise a ValueError unless two images have the same shape and both have a floating-point dtype."""
    if prediction.shape != target.shape:
        got = tuple(target.shape)
        raise ValueError(f"target: expected the prediction's shape {tuple(prediction.shape)}, got {got}")
    if not (prediction.is_floating_point() and target.is_floating_point()):
        raise ValueError(f"images: expected floating-point values in [0, 1], got {prediction.dtype} and {target.dtype}")


def _to_planes(images: Tensor) -> Tensor:
    """Reshape B images from (..., H, W, C), where B is the product of the leading axes, to (1, B*C, H, W). Each channel
    of each image becomes one plane of a grouped convolution."""
    height, width, channels = images.shape[-3:]
    planes = images.reshape(-1, height, width, channels).permute(0, 3, 1, 2)
    return planes.reshape(1, -1, height, width)


def _blur(planes: Tensor) -> Tensor:
    """Filter planes (1, P, H, W) with the Gaussian window. The result (1, P, H-10, W-10) contains only the pixels whose
    window is entirely inside the image."""
    count = planes.shape[1]
    offsets = torch.arange(WINDOW_PX, dtype=planes.dtype, device=planes.device) - WINDOW_PX // 2
    window = torch.softmax(-offsets.square() / (2 * SIGMA_PX**2), dim=0)
    rows = functional.conv2d(planes, window.view(1, 1, 1, -1).expand(count, -1, -1, -1), groups=count)
    return functional.conv2d(rows, window.view(1, 1, -1, 1).expand(count, -1, -1, -1), groups=count)
