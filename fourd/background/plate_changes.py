"""Whether a background holds still: pictures against the clean plates, beside the subject."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from fourd.background.plates import PlateView
from fourd.capture import Capture
from fourd.capture.layout import sample_indices

FRAMES = 6
"""Compared of each camera, evenly over the capture."""
CHANGED = 24.0
"""Levels of 255 that a colour may differ, once noise is blurred away and the exposure is the same."""
BLUR_PX = 2.0
MARGIN = 1 / 50
"""Of the picture's longer side: kept away from the matte, beside which lie soft edges and shadows."""
RESTLESS = 0.02
"""Of what is seen of the background: more is no longer chance."""


def find_changing_backgrounds(
    capture: Capture, cameras: Sequence[int], plates: Sequence[PlateView]
) -> dict[str, float]:
    """By camera the largest share of the background that differs from its plate in some frame, where that is over 2%.

    Args:
        capture: with mattes.
        cameras: indices of the cameras of ``plates``.
    """
    shares = {
        plate.name: max(
            _changed(capture, camera, frame, plate) for frame in sample_indices(capture.frame_count, FRAMES)
        )
        for camera, plate in zip(cameras, plates, strict=True)
    }
    return {name: share for name, share in shares.items() if share > RESTLESS}


def _changed(capture: Capture, camera: int, frame: int, plate: PlateView) -> float:
    reach = max(1, round(MARGIN * max(plate.seen.shape)))
    square = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    judged = (cv2.dilate(capture.mask(camera, frame), square) == 0) & plate.seen
    if not judged.any():
        return 0.0
    rgb = capture.image(camera, frame)
    now, still = (np.asarray(cv2.GaussianBlur(x.astype(np.float32), (0, 0), BLUR_PX)) for x in (rgb, plate.rgb))
    away = (now - still)[judged]
    return float((np.abs(away - np.median(away, axis=0)).max(axis=1) > CHANGED).mean())
