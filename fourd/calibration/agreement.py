"""Whether a capture's calibration agrees with its pictures: how far matches are from their epipolar lines."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fourd.calibration.ambiguities import matches_of_cameras
from fourd.calibration.residuals import WORST_PX, residuals_of
from fourd.capture.calibration import EXTRINSICS_NAME
from fourd.capture.layout import sample_indices
from fourd.capture.reader import open_capture
from fourd.progress import Track

FEW_CAMERAS = 5
FEW_FRAMES = 3
MOST_PIXELS = 2.1e6
"""Of a picture; larger ones are looked at reduced."""
ALL_PIXELS = 12e6
"""Of all pictures of a frame, so that a ring of cameras takes seconds."""


@dataclass(frozen=True)
class Agreement:
    """How well cameras agree with each other.

    Attributes:
        mean_px: mean of the pairs' medians, in pixels of the pictures; None where too few points match.
        worst: the camera that is worst by itself, and its residual in pixels; None as above.
        pairs: pairs of cameras with matches enough.
        matches: of all pairs.
        warnings: a line for each camera that disagrees, or one for all.
    """

    mean_px: float | None
    worst: tuple[str, float] | None
    pairs: int
    matches: int
    warnings: tuple[str, ...]


def check_agreement(path: Path | str, track: Track | None = None) -> Agreement:
    """Match a frame of all cameras, or 3 of up to 5, and compare with the calibration.

    ``track`` wraps loops, for progress. Raises UserError as open_capture.
    """
    whole = open_capture(path)
    largest = max(camera.width * camera.height for camera in whole.cameras)
    scale = min(1.0, float(np.sqrt(min(MOST_PIXELS, ALL_PIXELS / len(whole.cameras)) / largest)))
    capture = whole if scale == 1 else open_capture(path, scale=scale)
    is_few = len(capture.cameras) <= FEW_CAMERAS
    frames = sample_indices(capture.frame_count, FEW_FRAMES) if is_few else [capture.frame_count // 2]
    pictures = [[capture.image(camera, frame) for camera in range(len(capture.cameras))] for frame in frames]
    matches = matches_of_cameras(pictures, capture.cameras, track)
    found = residuals_of(matches, capture.cameras)
    count = sum(map(len, matches.values()))
    if not found.pairs:
        return Agreement(None, None, 0, count, ())
    shares = [(name, px / scale) for name, px in zip(capture.names, found.cameras, strict=True) if px is not None]
    medians = list(found.pairs.values())
    file, mean = Path(path) / EXTRINSICS_NAME, float(np.mean(medians)) / scale
    warnings = [
        f"{file}: camera '{capture.names[index]}' disagrees with the others "
        f"by {(found.cameras[index] or 0) / scale:.1f} px; calibrate it again, or leave it out with --views"
        for index in found.bad
    ]
    if not warnings and len(medians) > 1 and float(np.median(medians)) > WORST_PX:
        warnings.append(
            f"{file}: the cameras disagree by {mean:.1f} pixels in the mean, none more than the others; calibrate "
            "again, or import again: fourd import looks for resized pictures and mirrored principal points"
        )
    return Agreement(mean, max(shares, key=lambda share: share[1]), len(medians), count, tuple(warnings))
