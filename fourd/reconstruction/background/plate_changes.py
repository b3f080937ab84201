"""Detect backgrounds that are not static: compare frames with clean plates (images of the empty scene) outside the
mattes."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from fourd.reconstruction.background.plates import PlateView
from fourd.recording.capture import Capture
from fourd.recording.capture.layout import sample_indices

FRAMES = 6
"""Number of frames that are compared per camera, evenly spaced over the capture."""
MAX_DIFFERENCE = 24.0
"""Maximum colour difference, in 8-bit levels, between an unchanged pixel and the plate. The difference is computed
after blurring and exposure compensation."""
BLUR_PX = 2.0
MARGIN = 1 / 50
"""Width of a band around the matte. Pixels in the band are not compared, because the band contains soft edges and
shadows. The width is a fraction of the image's longer side."""
MAX_CHANGED_SHARE = 0.02
"""Maximum fraction of the visible background that may differ from the plate. Up to this fraction, the differences are
attributed to noise, and the background counts as static."""


def find_changing_backgrounds(
    capture: Capture, cameras: Sequence[int], plates: Sequence[PlateView]
) -> dict[str, float]:
    """Find the cameras whose background differs from the plate in more than 2% of its area in at least one frame.

    Args:
        capture: a capture with mattes.
        cameras: for each plate, the index of its camera in the capture.
        plates: clean plates.

    Returns:
        camera name -> changed fraction of the background, in [0, 1], in the frame with the largest change.
    """
    shares = {
        plate.name: max(
            _changed_share(capture, camera, frame, plate) for frame in sample_indices(capture.frame_count, FRAMES)
        )
        for camera, plate in zip(cameras, plates, strict=True)
    }
    return {name: share for name, share in shares.items() if share > MAX_CHANGED_SHARE}


def _changed_share(capture: Capture, camera: int, frame: int, plate: PlateView) -> float:
    """Compute the fraction, in [0, 1], of the visible background that differs from the plate in a frame."""
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
