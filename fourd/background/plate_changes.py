"""Detection of non-static backgrounds: pictures compared with the clean plates outside the mattes."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from fourd.background.plates import PlateView
from fourd.capture import Capture
from fourd.capture.layout import sample_indices

FRAMES = 6
"""Frames compared per camera, evenly spaced over the capture."""
MAX_DIFFERENCE = 24.0
"""Tolerated colour difference in levels of 255, after blurring and exposure compensation."""
BLUR_PX = 2.0
MARGIN = 1 / 50
"""Distance kept from the matte, beside which there are soft edges and shadows; relative to the longer side."""
MAX_CHANGED_SHARE = 0.02
"""Share of the visible background that may change; more is not noise."""


def find_changing_backgrounds(
    capture: Capture, cameras: Sequence[int], plates: Sequence[PlateView]
) -> dict[str, float]:
    """Find the cameras whose background differs from the plate by more than 2% of its area in some frame.

    Args:
        capture: pictures with mattes.
        cameras: indices of the cameras of ``plates``.
        plates: clean plates.

    Returns:
        the largest changed share in [0, 1] over the compared frames, by camera name.
    """
    shares = {
        plate.name: max(
            _changed_share(capture, camera, frame, plate) for frame in sample_indices(capture.frame_count, FRAMES)
        )
        for camera, plate in zip(cameras, plates, strict=True)
    }
    return {name: share for name, share in shares.items() if share > MAX_CHANGED_SHARE}


def _changed_share(capture: Capture, camera: int, frame: int, plate: PlateView) -> float:
    """Share of the visible background that differs from the plate in a frame."""
    reach = max(1, round(MARGIN * max(plate.seen.shape)))
    square = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    compared = (cv2.dilate(capture.mask(camera, frame), square) == 0) & plate.seen
    if not compared.any():
        return 0.0
    rgb = capture.image(camera, frame)
    blurred, background = (
        np.asarray(cv2.GaussianBlur(x.astype(np.float32), (0, 0), BLUR_PX)) for x in (rgb, plate.rgb)
    )
    difference = (blurred - background)[compared]
    exposure = np.median(difference, axis=0)
    return float((np.abs(difference - exposure).max(axis=1) > MAX_DIFFERENCE).mean())
