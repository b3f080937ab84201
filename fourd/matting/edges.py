"""From reduced log-odds to a matte of the whole picture with soft edges."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Picture = NDArray[np.uint8]

SMOOTHING = 2.0
COLOUR_EDGE = 10.0
BAND = 1 / 400
"""Half the width of the soft edge, as a share of the picture's longest side."""
EDGE_VARIANCE = 40.0
"""Of 8-bit colours squared: contrast below which the guided filter takes no edge for one."""
SMALLEST_PART = 1 / 300
"""Parts of the matte, and holes in it, of a smaller share of its area are dropped."""
MARGIN_PX = 16
LEAST_CONTRAST = 30.0
"""Between subject and background, of 8-bit colours, for a pixel's mixture of them to be told."""
NEAR_ENOUGH = 0.01
KNOWN = 0.9
"""Sureness from which the background behind an edge counts as known."""


def matte(log_odds: Floats, rgb: Picture, back: Floats | None = None) -> Picture:
    """(H, W) uint8 matte, 255 = subject, of a picture (H, W, 3) uint8.

    The log-odds (h, w), of any size, are enlarged along the picture's edges (fast global smoother, Min et al.
    2014); the edge between 0 and 255 follows the picture's (guided filter, He et al. 2013), and is the subject's
    share in the mixture of colours there. ``back`` (H, W, 4) has the background's colours, where they are known, and
    how sure that is, in [0, 1].
    """
    height, width = rgb.shape[:2]
    result = np.zeros((height, width), np.uint8)
    window = _window(log_odds, height, width)
    if window is None:
        return result
    rows, columns = window
    whole = cv2.resize(log_odds, (width, height), interpolation=cv2.INTER_LINEAR)
    part, picture = np.ascontiguousarray(whole[rows, columns]), np.ascontiguousarray(rgb[rows, columns])
    if log_odds.shape != (height, width):
        part = cv2.ximgproc.fastGlobalSmootherFilter(picture, part, SMOOTHING, COLOUR_EDGE)
    subject = cleaned((part > 0).astype(np.uint8))
    radius = max(1, round(BAND * max(height, width)))
    alpha = softened(subject, picture, radius)
    alpha = unmixed(picture, subject, alpha, max(2, radius), None if back is None else back[rows, columns])
    result[rows, columns] = (255 * alpha + 0.5).astype(np.uint8)
    return result


def softened(subject: Picture, rgb: Picture, radius: int) -> Floats:
    """(H, W) in [0, 1]: ones (H, W) uint8 whose edge, ``radius`` pixels to either side, follows the picture's.

    (Guided filter, He et al. 2013.)
    """
    soft = cv2.ximgproc.guidedFilter(rgb, subject.astype(np.float32), 2 * radius, EDGE_VARIANCE)
    square = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    edge = cv2.dilate(subject, square) != cv2.erode(subject, square)
    # The filter's ends are a little short of 0 and 1.
    return np.where(edge, np.clip(1.15 * soft - 0.075, 0, 1), subject)


def unmixed(rgb: Picture, subject: Picture, alpha: Floats, radius: int, back: Floats | None = None) -> Floats:
    """(H, W) in [0, 1]: at the subject's edge, its share in a pixel's mixture with what lies beside it.

    The colours to either side tell the share; ``back`` (H, W, 4), where it is sure, tells the one behind. Where the
    two are alike, ``alpha`` stands.
    """
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    inside = np.asarray(cv2.erode(subject, disc), np.float32)
    outside = 1 - np.asarray(cv2.dilate(subject, disc), np.float32)
    edge = (inside == 0) & (outside == 0)
    value = rgb.astype(np.float32)
    (front, front_near), (behind, behind_near) = (_around(value, sure, radius) for sure in (inside, outside))
    is_behind = behind_near > NEAR_ENOUGH
    if back is not None:
        is_known = back[..., 3] > KNOWN
        behind = np.where(is_known[..., None], back[..., :3], behind)
        is_behind |= is_known
    across = front - behind
    length = np.square(across).sum(axis=-1)
    share = ((value - behind) * across).sum(axis=-1) / np.maximum(length, 1)
    known = edge & (front_near > NEAR_ENOUGH) & is_behind & (length > LEAST_CONTRAST**2)
    return np.where(known, np.clip(share, 0, 1), alpha).astype(np.float32)


def _around(value: Floats, sure: Floats, radius: int) -> tuple[Floats, Floats]:
    """Mean colour near each pixel (H, W, 3) of those where ``sure`` (H, W) is 1, and their share of all there."""
    near = np.asarray(cv2.GaussianBlur(sure, (0, 0), 1.5 * radius), np.float32)
    total = np.asarray(cv2.GaussianBlur(value * sure[..., None], (0, 0), 1.5 * radius), np.float32)
    return (total / np.maximum(near, 1e-6)[..., None]).astype(np.float32), near


def cleaned(subject: Picture) -> Picture:
    """Ones (H, W) without small parts and small holes."""
    least = SMALLEST_PART * np.count_nonzero(subject)
    return 1 - _without_small(1 - _without_small(subject, least), least)


def _without_small(picture: Picture, least: float) -> Picture:
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(picture, connectivity=4)
    keep = statistics[:, cv2.CC_STAT_AREA] >= least
    keep[0] = False
    return keep[labels].astype(np.uint8) if count > 1 else picture


def _window(log_odds: Floats, height: int, width: int) -> tuple[slice, slice] | None:
    """The subject's box in the whole picture with a margin; None where there is no subject."""
    left, top, box_width, box_height = cv2.boundingRect((log_odds > 0).astype(np.uint8))
    if box_width == 0:
        return None
    zoom_y, zoom_x = height / log_odds.shape[0], width / log_odds.shape[1]
    first_row, last_row = int(top * zoom_y) - MARGIN_PX, int(np.ceil((top + box_height) * zoom_y)) + MARGIN_PX
    first_column, last_column = int(left * zoom_x) - MARGIN_PX, int(np.ceil((left + box_width) * zoom_x)) + MARGIN_PX
    return slice(max(0, first_row), min(height, last_row)), slice(max(0, first_column), min(width, last_column))
