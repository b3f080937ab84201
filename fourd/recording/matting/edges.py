"""Full-resolution mattes with soft edges, from low-resolution log-odds that a pixel shows the subject."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.recording.matting.channels import channel_sum

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]
Flags = NDArray[np.bool_]

SMOOTHING = 2.0
COLOUR_EDGE = 10.0
BAND = 1 / 400
"""Half the width of the soft edge, as a fraction of the image's longest side."""
MIN_REGION_SHARE = 1 / 300
"""Minimum area of a connected region or hole, as a fraction of the subject's area. Smaller regions are removed, and
smaller holes are filled."""
MARGIN_PX = 16
NOISE_VARIANCE = np.float32(16.0)
"""Variance of the difference between a pixel's value and the mixture of subject and background, in squared 8-bit
values.

It accounts for camera noise and image compression.
"""
SUBJECT_VARIANCE = np.float32(60.0)
"""Variance added to the subject's local colour variance, because shading changes the colours towards the edge."""
NEARBY_VARIANCE = np.float32(12.0)
"""Variance added to the background's local colour variance where the background's colour is estimated from nearby
pixels."""
PLATE_VARIANCE = np.float32(9.0)
SHADING_DEVIATION = np.float32(0.1)
"""Standard deviation of the light on the edge of the subject, as a fraction of the light on nearby parts of the
subject. It accounts for curved surfaces, which become darker towards their contour. Without it, a dark pixel of the
subject would look like a mixture with a dark background."""
CHROMA_VARIANCE = np.float32(0.1)
"""Variance of a pixel's chroma, as a fraction of the squared difference in chroma between subject and background. JPEG
images and videos store chroma at half the resolution, so that chroma is blurred across the edge."""
NORMALISER_WEIGHT = np.float32(0.3)
"""Weight of the normalisation term, the logarithm of the variance, in the log-likelihood of a pixel's colour. The
variance of the subject's colours is overestimated. With weight 1, the term would therefore reduce the likelihood of the
subject too much, and the edge would move into the subject."""
PRIOR_DEVIATIONS = (0.6, 0.4, 0.25)
"""Standard deviations of the prior of alpha, a Gaussian around the blurred mask. Alpha is estimated once per value:
each estimate corrects the mask, and the next estimate takes the colours on both sides of the edge from the corrected
mask. The small last value reduces noise."""
ALPHAS = 11
"""Number of values from 0 to 1 at which the posterior of alpha is evaluated."""
SHARPENING_SIGMA = 0.6
"""Standard deviation of the Gaussian that averages alpha over neighbouring pixels, as a multiple of half the width of
the soft edge."""
SHARPENING_GAIN = np.float32(2.0)
"""Factor that increases the contrast of the averaged alpha. Without it, the edge would be too soft, because alpha is
the mean of a posterior."""
MIN_NEARBY = 0.005
MIN_CONFIDENCE = 0.5
"""A given background colour is used to estimate alpha only if its confidence is above this value."""
LUMA_CHROMA = np.array([[0.45, 0.88, 0.17], [-0.27, -0.53, 0.80], [0.76, -0.64, -0.12]], np.float32)
"""Unit vectors of Y, Cb and Cr in RGB space, the axes along which JPEG images and videos store colours."""


def refine_matte(log_odds: Floats, rgb: Picture, background: Floats | None = None) -> Picture:
    """Compute a full-resolution matte (H, W) uint8, 255 = subject.

    The log-odds are upsampled with an edge-preserving filter guided by the image (fast global smoother, Min et al.
    2014). The alpha of edge pixels is then estimated from the colours on both sides of the edge.

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
    known = None if background is None else background[rows, columns]
    alpha = estimate_edge_alpha(picture, subject, radius, known)
    result[rows, columns] = (255 * alpha + 0.5).astype(np.uint8)
    return result


def estimate_edge_alpha(rgb: Picture, subject: Picture, radius: int, background: Floats | None = None) -> Floats:
    """Estimate alpha (H, W) in [0, 1] near the edge of a binary mask (H, W) uint8, 1 = subject.

    The colour of an edge pixel is modelled as a mixture of the subject's colour and the background's colour, which both
    have Gaussian distributions. Alpha is the mean of its posterior, as in Bayesian matting (Chuang et al. 2001). The
    prior of alpha is a Gaussian around the blurred mask, so the mask determines alpha where subject and background have
    similar colours. The likelihood also allows for the shading of the subject and for blurred chroma.

    The subject's colour is a local mean inside the mask. The background's colour is a local mean outside the mask, or
    the colour in ``background`` (H, W, 4) where the confidence is high. Alpha differs from the mask only at pixels
    within three times ``radius`` of the mask's edge. Alpha is then averaged over neighbouring pixels and sharpened,
    because the posterior's mean is softer than the edge. The estimation has one pass per value of PRIOR_DEVIATIONS. The
    mask of each later pass contains the pixels whose alpha is at least 0.5 after the previous pass.
    """
    alpha = subject.astype(np.float32)
    edge = (cv2.dilate(subject, _disc(3 * radius)) > 0) & (cv2.erode(subject, _disc(3 * radius)) == 0)
    for deviation in PRIOR_DEVIATIONS:
        mask = (alpha >= 0.5).astype(np.uint8)
        soft = _mean_alpha(rgb, mask, edge, radius, background, deviation)
        average = np.asarray(cv2.GaussianBlur(soft, (0, 0), SHARPENING_SIGMA * radius), np.float32)
        alpha = np.where(edge, np.clip(0.5 + SHARPENING_GAIN * (average - 0.5), 0, 1), soft).astype(np.float32)
    return alpha


def _mean_alpha(
    rgb: Picture, mask: Picture, edge: Flags, radius: int, background: Floats | None, deviation: float
) -> Floats:
    """Return alpha (H, W) for a binary mask (H, W). At pixels near the mask's edge, where ``edge`` (H, W) is true,
    alpha is its posterior mean if the colours of the subject and of the background are known there. At all other
    pixels, alpha is the mask's value.

    ``deviation`` is the standard deviation of alpha around the blurred mask.
    """
    inside = np.asarray(cv2.erode(mask, _disc(radius)), np.float32)
    outside = 1 - np.asarray(cv2.dilate(mask, _disc(radius)), np.float32)
    value = rgb.astype(np.float32)
    front, front_variance, front_near = _local_colours(value, inside, float(radius))
    back, back_variance, back_near = _local_colours(value, outside, 2.0 * radius)
    back_variance += NEARBY_VARIANCE
    has_back = back_near > MIN_NEARBY
    if background is not None:
        is_known = background[..., 3] > MIN_CONFIDENCE
        back[is_known], back_variance[is_known] = background[is_known, :3], PLATE_VARIANCE
        has_back |= is_known
    chosen = edge & (front_near > MIN_NEARBY) & has_back
    prior = np.asarray(cv2.GaussianBlur(mask.astype(np.float32), (0, 0), float(radius)), np.float32)
    alpha = mask.astype(np.float32)
    alpha[chosen] = _posterior_alpha(
        value[chosen],
        (front[chosen], front_variance[chosen] + SUBJECT_VARIANCE),
        (back[chosen], back_variance[chosen]),
        prior[chosen],
        deviation,
    )
    return alpha


def _posterior_alpha(
    value: Floats, front: tuple[Floats, Floats], back: tuple[Floats, Floats], prior: Floats, deviation: float
) -> Floats:
    """Return the posterior mean (N,) of alpha for the colours ``value`` (N, 3).

    ``front`` contains the mean and the variance (N, 3) of the subject's colour at each pixel, and ``back`` contains the
    same values for the background's colour. ``deviation`` is the standard deviation of alpha around ``prior`` (N,).

    In the model, the light on the subject is a Gaussian random variable that multiplies all channels of the subject's
    colour. The other errors of the channels are independent. The covariance of a colour is therefore the sum of a
    diagonal matrix and the outer product of one vector, the deviation that the light causes, with itself. The inverse
    and the determinant of the covariance follow from the Sherman-Morrison formula and the matrix determinant lemma.
    """
    value, front_mean, back_mean = value @ LUMA_CHROMA.T, front[0] @ LUMA_CHROMA.T, back[0] @ LUMA_CHROMA.T
    front_variance, back_variance = front[1] @ np.square(LUMA_CHROMA.T), back[1] @ np.square(LUMA_CHROMA.T)
    noise = np.full_like(value, NOISE_VARIANCE)
    noise[:, 1:] += CHROMA_VARIANCE * np.square(front_mean - back_mean)[:, 1:]
    costs = []
    alphas = np.linspace(0, 1, ALPHAS, dtype=np.float32)
    for alpha in alphas:
        variance = alpha**2 * front_variance + (1 - alpha) ** 2 * back_variance + noise
        difference = value - alpha * front_mean - (1 - alpha) * back_mean
        shading = alpha * SHADING_DEVIATION * front_mean
        scaled = shading / variance
        growth = 1 + channel_sum(shading * scaled)
        cost = channel_sum(np.square(difference) / variance) - np.square(channel_sum(difference * scaled)) / growth
        cost += NORMALISER_WEIGHT * (channel_sum(np.log(variance)) + np.log(growth))
        costs.append(cost + np.square((alpha - prior) / np.float32(deviation)))
    lowest = np.minimum.reduce(costs)
    total, weighted = np.zeros(len(value), np.float32), np.zeros(len(value), np.float32)
    for alpha, cost in zip(alphas, costs, strict=True):
        weight = np.exp(0.5 * (lowest - cost))
        total += weight
        weighted += alpha * weight
    return weighted / total


def _local_colours(value: Floats, mask: Floats, deviation_px: float) -> tuple[Floats, Floats, Floats]:
    """Return the Gaussian-weighted mean and variance (H, W, 3) of the colours of nearby pixels in ``mask``, and the sum
    of weights."""

    def blur(plane: Floats) -> Floats:
        return np.asarray(cv2.GaussianBlur(plane, (0, 0), deviation_px), np.float32)

    near = blur(mask)
    share = (1 / np.maximum(near, np.float32(1e-6)))[..., None]
    mean = blur(value * mask[..., None]) * share
    variance = np.maximum(blur(np.square(value) * mask[..., None]) * share - np.square(mean), 0)
    return np.asarray(mean, np.float32), np.asarray(variance, np.float32), near


def _disc(radius: int) -> Picture:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)), np.uint8)


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
    """Return the bounding box of the subject plus a margin, in full-resolution pixels, or None if no pixel shows the
    subject."""
    left, top, box_width, box_height = cv2.boundingRect((log_odds > 0).astype(np.uint8))
    if box_width == 0:
        return None
    zoom_y, zoom_x = height / log_odds.shape[0], width / log_odds.shape[1]
    first_row, last_row = int(top * zoom_y) - MARGIN_PX, int(np.ceil((top + box_height) * zoom_y)) + MARGIN_PX
    first_column, last_column = int(left * zoom_x) - MARGIN_PX, int(np.ceil((left + box_width) * zoom_x)) + MARGIN_PX
    return slice(max(0, first_row), min(height, last_row)), slice(max(0, first_column), min(width, last_column))
