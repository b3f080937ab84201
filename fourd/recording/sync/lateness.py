"""Detection of cameras whose images are late or early, by comparing the motion in the images of all cameras."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from fourd.base.progress import Track, untracked
from fourd.recording.capture.reader import open_capture
from fourd.recording.sync.epipolar import MotionRecord, estimate_epipolar_offsets
from fourd.recording.sync.motion import MIN_CONFIDENCE, UNRELIABLE_FRAMES, WIDTH_PX

MAX_FRAMES = 300
"""Maximum number of frames that are compared. They are taken from the middle of the capture."""
MIN_FRAMES = 36
"""Minimum number of frames that are needed for the comparison."""


def find_late_cameras(path: Path | str, track: Track = untracked) -> list[str]:
    """Find the cameras in which motion is early or late by more than 3 frames compared with the other cameras.

    Args:
        path: the capture's folder.
        track: callback that reports progress.

    Returns:
        one line of text for each camera that is early or late. The list is empty for captures with fewer than 36 frames
        or with fewer than 3 cameras.

    Raises:
        UserError: if the capture cannot be opened, or an image cannot be decoded.
    """
    with open_capture(path, mattes=False) as capture:
        names, total = capture.names, capture.frame_count
        widest = max(camera.width for camera in capture.cameras)
    if total < MIN_FRAMES or len(names) < 3:
        return []
    count = min(total, MAX_FRAMES)
    first = (total - count) // 2
    records = []
    with open_capture(path, mattes=False, scale=min(1.0, WIDTH_PX / widest)) as capture:
        for index, name in enumerate(names):
            numbers = track(range(first, first + count), count, f"motion of {name}")
            records.append(
                MotionRecord.of(
                    np.asarray(cv2.cvtColor(capture.image(index, number), cv2.COLOR_RGB2GRAY), np.uint8)
                    for number in numbers
                )
            )
        found = estimate_epipolar_offsets(records, capture.cameras, count // 3)
    if found is None:
        return []
    usual = int(np.median(found.frames))
    lines = []
    for name, frames, confidence in zip(names, found.frames, found.confidence, strict=True):
        late = frames - usual
        if abs(late) > UNRELIABLE_FRAMES and confidence >= MIN_CONFIDENCE:
            lines.append(
                f"{path}: camera '{name}' is {'late' if late > 0 else 'early'} by {abs(late)} frames compared with the "
                f"motion in the other cameras (confidence {confidence:.0%}); import its video with "
                f"--offset {name}={late}, or record again with a common trigger"
            )
    return lines
