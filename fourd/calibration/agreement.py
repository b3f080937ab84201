"""Check of a calibration with the epipolar residuals of feature matches between the capture's images."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fourd.calibration.camera_matching import match_cameras
from fourd.calibration.residuals import MAX_GOOD_PX, compute_residuals
from fourd.capture.calibration import EXTRINSICS_NAME
from fourd.capture.layout import sample_indices
from fourd.capture.reader import open_capture
from fourd.progress import Track

FEW_CAMERAS = 5
FEW_CAMERAS_FRAMES = 3
MAX_PICTURE_PIXELS = 2.1e6
"""Maximum number of pixels per image; larger images are reduced."""
MAX_FRAME_PIXELS = 12e6
"""Maximum total number of pixels of one frame's images from all cameras; larger images are reduced.

Because of this limit on pixels, the check of a ring of cameras takes only seconds.
"""


@dataclass(frozen=True)
class Agreement:
    """Result of the check of a calibration.

    Attributes:
        mean_px: mean over the camera pairs of their median residuals, in pixels of the full-size images, or None if no
            camera pair has enough matches.
        worst: name of the camera with the largest residual, and its residual in pixels, or None if no camera pair has
            enough matches.
        pairs: number of camera pairs with enough matches.
        matches: total number of matches.
        warnings: one line for each camera that disagrees with the others, or one line if all cameras disagree.
    """

    mean_px: float | None
    worst: tuple[str, float] | None
    pairs: int
    matches: int
    warnings: tuple[str, ...]


def check_agreement(path: Path | str, track: Track | None = None) -> Agreement:
    """Compute the epipolar residuals of a capture's calibration.

    With up to 5 cameras, the check uses 3 frames. With more cameras, it uses only the middle frame.

    Args:
        path: the capture's folder.
        track: progress callback.

    Raises:
        UserError: if the capture cannot be opened; see :func:`fourd.capture.open_capture`.
    """
    whole = open_capture(path)
    largest = max(camera.width * camera.height for camera in whole.cameras)
    max_pixels = min(MAX_PICTURE_PIXELS, MAX_FRAME_PIXELS / len(whole.cameras))
    scale = min(1.0, float(np.sqrt(max_pixels / largest)))
    capture = whole if scale == 1 else open_capture(path, scale=scale)
    has_few = len(capture.cameras) <= FEW_CAMERAS
    frames = sample_indices(capture.frame_count, FEW_CAMERAS_FRAMES) if has_few else [capture.frame_count // 2]
    pictures = [[capture.image(camera, frame) for camera in range(len(capture.cameras))] for frame in frames]
    matches = match_cameras(pictures, capture.cameras, track)
    found = compute_residuals(matches, capture.cameras)
    count = sum(map(len, matches.values()))
    if not found.pairs:
        return Agreement(None, None, 0, count, ())
    by_camera = [(name, px / scale) for name, px in zip(capture.names, found.cameras, strict=True) if px is not None]
    medians = list(found.pairs.values())
    file, mean = Path(path) / EXTRINSICS_NAME, float(np.mean(medians)) / scale
    warnings = [
        f"{file}: camera '{capture.names[index]}' disagrees with the others "
        f"by {(found.cameras[index] or 0) / scale:.1f} px; calibrate it again, or exclude it with --views"
        for index in found.bad
    ]
    if not warnings and len(medians) > 1 and float(np.median(medians)) > MAX_GOOD_PX:
        warnings.append(
            f"{file}: all cameras disagree by similar amounts, on average by {mean:.1f} px; calibrate again, or run "
            "fourd import again to check for resized images and mirrored principal points"
        )
    return Agreement(mean, max(by_camera, key=lambda camera: camera[1]), len(medians), count, tuple(warnings))
