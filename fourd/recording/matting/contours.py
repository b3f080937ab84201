"""Check whether mattes belong to their images: the contour of a matte should follow edges in its image.

The mean image gradient along a matte's contour is compared with the gradient along the same contour shifted in eight
directions. If the matte belongs to the image, the gradient is largest without a shift. If the matte belongs to another
image, each of the nine positions has the largest gradient with about the same probability.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.progress import Track, untracked
from fourd.recording.capture.layout import sample_indices
from fourd.recording.capture.reader import open_capture

FRAMES = 5
SHIFT = 0.01
"""Length by which a contour is shifted to compare the image gradients at both positions, as a fraction of the longer
image side. It is larger than the position errors of correct contours."""
MIN_SHIFT_PX = 3
MIN_CONTOUR_PX = 40
MAX_FITTING = 0.25
"""A camera is reported if at most this fraction of its mattes follows the edges of the images."""
MIN_MATTES = 2


def find_foreign_mattes(path: Path | str, track: Track = untracked) -> list[str]:
    """Find cameras whose mattes do not follow the edges of their images.

    Args:
        path: the capture's folder.
        track: progress callback.

    Returns:
        A list with one line that names the cameras, or an empty list if no camera is found.

    Raises:
        UserError: if the capture cannot be opened, or an image cannot be decoded.
    """
    with open_capture(path, partial_mattes=True) as opened:
        # If the user provided masks of some cameras, the mattes of the others are only as exact as a visual hull.
        own = [index for index in opened.masked if index not in opened.generated]
        capture = opened.select(own or opened.masked)
        count = len(capture.names)
        frames = sample_indices(capture.frame_count, FRAMES)
        foreign = []
        for index in track(range(len(capture.names)), len(capture.names), "mattes"):
            fits = [fits_image(capture.image(index, frame), capture.mask(index, frame)) for frame in frames]
            judged = [fit for fit in fits if fit is not None]
            if len(judged) >= MIN_MATTES and sum(judged) <= MAX_FITTING * len(judged):
                foreign.append(capture.names[index])
    if not foreign:
        return []
    which = "all cameras" if len(foreign) == count else f"camera {', '.join(foreign)}"
    return [
        f"{path}: the mattes of {which} do not follow the contours in the images; they may belong to another recording "
        "or to other frames; make them again with fourd matte, or copy the right masks"
    ]


def fits_image(picture: NDArray[np.uint8], matte: NDArray[np.uint8]) -> bool | None:
    """Return whether the contour of ``matte`` (H, W) follows edges of ``picture`` (H, W, 3); None if the contour is too
    short."""
    height, width = matte.shape
    shift = max(MIN_SHIFT_PX, round(SHIFT * max(height, width)))
    grey = cv2.GaussianBlur(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 1.0)
    gradient = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))
    inside = (matte > 127).astype(np.uint8)
    contour = cv2.morphologyEx(inside, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
    rows, columns = np.nonzero(contour)
    is_free = (np.minimum(rows, height - 1 - rows) >= shift) & (np.minimum(columns, width - 1 - columns) >= shift)
    rows, columns = rows[is_free], columns[is_free]
    if len(rows) < MIN_CONTOUR_PX:
        return None
    means = {
        (y, x): float(gradient[rows + y, columns + x].mean()) for y in (-shift, 0, shift) for x in (-shift, 0, shift)
    }
    return means[0, 0] >= max(means.values())
