"""How well a capture's calibration agrees with its pictures, by epipolar residuals."""

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
"""Larger pictures are reduced."""
MAX_FRAME_PIXELS = 12e6
"""Of all pictures of a frame together, so that a ring of cameras takes seconds."""


@dataclass(frozen=True)
class Agreement:
    """How well the cameras agree with each other.

    Attributes:
        mean_px: mean over pairs of the median residual, in pixels of the pictures; None where too few points match.
        worst: the camera with the largest residual of its own, and that residual in pixels; None as above.
        pairs: number of pairs of cameras with enough matches.
        matches: number of matches of all pairs.
        warnings: one line for each camera that disagrees, or one for all together.
    """

    mean_px: float | None
    worst: tuple[str, float] | None
    pairs: int
    matches: int
    warnings: tuple[str, ...]


def check_agreement(path: Path | str, track: Track | None = None) -> Agreement:
    """Compute the residuals of a capture's calibration on one frame, or on 3 frames of up to 5 cameras.

    ``track`` wraps loops for progress. Raises UserError as open_capture.
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
        f"by {(found.cameras[index] or 0) / scale:.1f} px; calibrate it again, or leave it out with --views"
        for index in found.bad
    ]
    if not warnings and len(medians) > 1 and float(np.median(medians)) > MAX_GOOD_PX:
        warnings.append(
            f"{file}: the cameras disagree by {mean:.1f} pixels in the mean, none more than the others; calibrate "
            "again, or import again: fourd import checks for resized pictures and mirrored principal points"
        )
    return Agreement(mean, max(by_camera, key=lambda camera: camera[1]), len(medians), count, tuple(warnings))
