"""Full-resolution mattes with soft edges from low-resolution log-odds."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

SMOOTHING = 2.0
COLOUR_EDGE = 10.0
BAND = 1 / 400
"""Half the width of the soft edge, as a share of the image's longest side."""
EDGE_VARIANCE = 40.0
"""Regularisation of the guided filter in squared 8-bit values. Areas with a lower colour variance are smoothed."""
MIN_REGION_SHARE = 1 / 300
"""Minimum area of a connected region or hole, as a share of the subject's area. Smaller regions are removed, and
smaller holes are filled."""
MARGIN_PX = 16
MIN_CONTRAST = 30.0
"""Minimum RGB distance, in 8-bit values, between subject and background at which alpha is estimated from colours."""
MIN_NEARBY = 0.01
MIN_CONFIDENCE = 0.9
"""Minimum confidence of a background colour that is used to estimate alpha."""


def refine_matte(log_odds: Floats, rgb: Picture, background: Floats | None = None) -> Picture:
    """Compute a full-resolution matte (H, W) uint8, 255 = subject.

    The log-odds are upsampled with an edge-preserving filter guided by the image (fast global smoother, Min et al.
    2014). A guided filter (He et al. 2013) aligns the soft edge with the image. Finally, the alpha of edge pixels is
    estimated from the colours on both sides of the edge.

    Args:
        log_odds: (h, w) log-odds at any resolution; positive values are the subject.
        rgb: (H, W, 3) uint8 image.
        background: (H, W, 4) background colours, 0 to 255, and their confidence in [0, 1], or None if unknown.
    """
    height, width = rgb.shape[:2]
    result = np.zeros((height, width), np.uint8)
    window = _subject_window(log_odds, height, width)
    if window is None:
        return result
    rows, columns = window
    whole = cv2.resize(log_odds, (width, height), interpolation=cv2.INTER_LINEAR)
    part, picture = np.ascontiguousarray(whole[rows, columns]), np.ascontiguousarray(rgb[rows, columns])
    if log_odds.shape != (height, width):
        part = cv2.ximgproc.fastGlobalSmootherFilter(picture, part, SMOOTHING, COLOUR_EDGE)
    subject = remove_small_regions((part > 0).astype(np.uint8))
    radius = max(1, round(BAND * max(height, width)))
    alpha = soften_edge(subject, picture, radius)
    known = None if background is None else background[rows, columns]
    alpha = estimate_edge_alpha(picture, subject, alpha, max(2, radius), known)
    result[rows, columns] = (255 * alpha + 0.5).astype(np.uint8)
    return result


def soften_edge(subject: Picture, rgb: Picture, radius: int) -> Floats:
    """Compute soft alpha (H, W) in [0, 1] from a binary mask (H, W) uint8, 1 = subject.

    A guided filter (He et al. 2013) aligns the mask's edge with the image. Only pixels within ``radius`` of the mask's
    edge change.
    """
    soft = cv2.ximgproc.guidedFilter(rgb, subject.astype(np.float32), 2 * radius, EDGE_VARIANCE)
    square = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    edge = cv2.dilate(subject, square) != cv2.erode(subject, square)
    # The guided filter's output does not reach 0 and 1 exactly, so its range is stretched.
    return np.where(edge, np.clip(1.15 * soft - 0.075, 0, 1), subject)


def estimate_edge_alpha(
    rgb: Picture, subject: Picture, alpha: Floats, radius: int, background: Floats | None = None
) -> Floats:
    """Estimate alpha (H, W) in [0, 1]: an edge pixel is a mixture of the subject's and the background's colour.

    The subject's colour is a local mean inside the subject. The background's colour is a local mean outside the
    subject, or the colour in ``background`` (H, W, 4) where the confidence is high. Where the contrast of subject and
    background is too low, ``alpha`` is kept.
    """
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    inside = np.asarray(cv2.erode(subject, disc), np.float32)
    outside = 1 - np.asarray(cv2.dilate(subject, disc), np.float32)
    edge = (inside == 0) & (outside == 0)
    value = rgb.astype(np.float32)
    (front, front_near), (back, back_near) = (_local_mean(value, mask, radius) for mask in (inside, outside))
    has_back = back_near > MIN_NEARBY
    if background is not None:
        is_known = background[..., 3] > MIN_CONFIDENCE
        back = np.where(is_known[..., None], background[..., :3], back)
        has_back |= is_known
    contrast = front - back
    squared = np.square(contrast).sum(axis=-1)
    share = ((value - back) * contrast).sum(axis=-1) / np.maximum(squared, 1)
    is_estimated = edge & (front_near > MIN_NEARBY) & has_back & (squared > MIN_CONTRAST**2)
    return np.where(is_estimated, np.clip(share, 0, 1), alpha).astype(np.float32)


def _local_mean(value: Floats, mask: Floats, radius: int) -> tuple[Floats, Floats]:
    """Gaussian-weighted mean colour (H, W, 3) of nearby pixels in ``mask`` (H, W), and the sum of weights (H, W)."""
    near = np.asarray(cv2.GaussianBlur(mask, (0, 0), 1.5 * radius), np.float32)
    total = np.asarray(cv2.GaussianBlur(value * mask[..., None], (0, 0), 1.5 * radius), np.float32)
    return (total / np.maximum(near, 1e-6)[..., None]).astype(np.float32), near


def remove_small_regions(subject: Picture) -> Picture:
    """Remove small connected regions from a binary mask (H, W), and fill small holes."""
    min_area = MIN_REGION_SHARE * np.count_nonzero(subject)
    return 1 - _remove_small_components(1 - _remove_small_components(subject, min_area), min_area)


def _remove_small_components(picture: Picture, min_area: float) -> Picture:
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(picture, connectivity=4)
    keep = statistics[:, cv2.CC_STAT_AREA] >= min_area
    keep[0] = False
    return keep[labels].astype(np.uint8) if count > 1 else picture


def _subject_window(log_odds: Floats, height: int, width: int) -> tuple[slice, slice] | None:
    """Bounding box of the subject plus a margin, in full-resolution pixels, or None if no pixel is the subject."""
    left, top, box_width, box_height = cv2.boundingRect((log_odds > 0).astype(np.uint8))
    if box_width == 0:
        return None
    zoom_y, zoom_x = height / log_odds.shape[0], width / log_odds.shape[1]
    first_row, last_row = int(top * zoom_y) - MARGIN_PX, int(np.ceil((top + box_height) * zoom_y)) + MARGIN_PX
    first_column, last_column = int(left * zoom_x) - MARGIN_PX, int(np.ceil((left + box_width) * zoom_x)) + MARGIN_PX
    return slice(max(0, first_row), min(height, last_row)), slice(max(0, first_column), min(width, last_column))
