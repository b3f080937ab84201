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


def matte(log_odds: Floats, rgb: Picture) -> Picture:
    """(H, W) uint8 matte, 255 = subject, of a picture (H, W, 3) uint8.

    The log-odds (h, w), of any size, are enlarged along the picture's edges (fast global smoother, Min et al.
    2014); the edge between 0 and 255 follows the picture's (guided filter, He et al. 2013).
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
