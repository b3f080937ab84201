"""Correction of given cameras by bundle adjustment with feature matches.

Bundle adjustment runs three times on the same matches. Each run uses only matches near their epipolar lines, and the
maximum distance from these lines decreases from run to run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.progress import Track
from fourd.recording.calibration.adjustment.solver import Prior, reprojection_errors_px, solve
from fourd.recording.calibration.adjustment.tracks import FrameMatches, Observations, build_tracks, triangulate_points
from fourd.recording.capture.layout import sample_indices
from fourd.recording.capture.pictures.mask_source import MaskSource
from fourd.recording.stereo.colmap import KNOWN_CAMERAS, temporary_workspace
from fourd.recording.stereo.features import Features, match_features, pairs_to_match

MAX_FRAMES = 2
MIN_FEATURES = 20
"""Minimum number of features per camera. A camera with fewer features keeps its given calibration."""
INLIER_SCALES = 4.0
"""A feature is an outlier if its reprojection error exceeds this multiple of the scale of the Cauchy loss."""
FINAL_BAND_PX = 3.0
"""Maximum distance, in pixels, of a match from its epipolar lines in the last of the three bundle adjustments."""
FINAL_SCALE_PX = 1.0
"""Scale, in pixels, of the Cauchy loss in the last two of the three bundle adjustments."""


@dataclass(frozen=True, eq=False)
class Adjustment:
    """Result of a camera adjustment.

    Attributes:
        cameras: adjusted cameras in the order of the given cameras.
        features: (V,) number of inlier features of each camera.
        before_px: median reprojection error of the inliers with the given cameras, in pixels, or NaN if there are no
            inliers.
        after_px: median reprojection error of the inliers with the adjusted cameras, in pixels, or NaN if there are no
            inliers.
    """

    cameras: tuple[Camera, ...]
    features: NDArray[np.intp]
    before_px: float
    after_px: float


def adjust_cameras(capture: MaskSource, cameras: Sequence[int], prior: Prior, band: float, track: Track) -> Adjustment:
    """Adjust the selected cameras of a capture with feature matches from one or two of the capture's frames.

    Args:
        capture: undistorted images and an approximate calibration.
        cameras: indices of the cameras to be adjusted.
        prior: standard deviations of the errors in the given calibration.
        band: maximum distance of a match from the epipolar lines of the given cameras, as a fraction of the longest
            image side of all cameras.
        track: callback that reports progress.

    Returns:
        the adjusted cameras in the order of ``cameras``. A camera with too few matches keeps its given calibration.
    """
    given = tuple(capture.cameras[index] for index in cameras)
    frames = []
    for frame in sample_indices(capture.frame_count, MAX_FRAMES):
        features = _frame_features(capture, cameras, frame, track)
        matches = {(i, j): match_features(features[i], features[j]) for i, j in pairs_to_match(given)}
        frames.append(FrameMatches(tuple(features), matches))
    return adjust_to_matches(given, frames, prior, band)


def adjust_to_matches(given: Sequence[Camera], frames: Sequence[FrameMatches], prior: Prior, band: float) -> Adjustment:
    """Adjust the initial cameras ``given`` to feature matches.

    See :func:`adjust_cameras` for ``prior`` and ``band``.
    """
    wide = band * max(max(camera.width, camera.height) for camera in given)
    cameras, tracks, after = tuple(given), build_tracks(frames, given, wide), float("nan")
    for band_px, scale_px in ((wide, wide / 4), (wide / 2, FINAL_SCALE_PX), (FINAL_BAND_PX, FINAL_SCALE_PX)):
        tracks = build_tracks(frames, cameras, band_px)
        cameras, tracks, after = _adjust_once(given, cameras, tracks, prior, band_px, scale_px)
    xyz, _ = triangulate_points(tracks, given)
    before = float(np.median(reprojection_errors_px(tracks, given, xyz))) if len(tracks.camera) else float("nan")
    return Adjustment(cameras, np.bincount(tracks.camera, minlength=len(given)), before, after)


def _adjust_once(
    given: Sequence[Camera],
    start: Sequence[Camera],
    tracks: Observations,
    prior: Prior,
    band_px: float,
    scale_px: float,
) -> tuple[tuple[Camera, ...], Observations, float]:
    """Run one bundle adjustment with the initial cameras ``start``.

    Returns:
        the adjusted cameras, the inlier features, and the median reprojection error of the inliers in pixels.
    """
    xyz, is_wide = triangulate_points(tracks, start)
    tracks = tracks.of_points(is_wide)
    xyz = xyz[is_wide]
    tracks = tracks.select(reprojection_errors_px(tracks, start, xyz) < 2 * band_px)
    count = np.bincount(tracks.camera, minlength=len(given))
    tracks = tracks.select(count[tracks.camera] >= MIN_FEATURES)
    if not len(tracks.camera):
        return tuple(given), tracks, float("nan")
    xyz, _ = triangulate_points(tracks, start)
    cameras, xyz = solve(given, start, tracks, xyz, prior, scale_px)
    errors = reprojection_errors_px(tracks, cameras, xyz)
    inliers = errors < INLIER_SCALES * scale_px
    return cameras, tracks.select(inliers), float(np.median(errors[inliers])) if inliers.any() else float("nan")


def _frame_features(capture: MaskSource, cameras: Sequence[int], frame: int, track: Track) -> list[Features]:
    """Detect the features of each camera in one frame."""
    pictures = [capture.image(index, frame) for index in cameras]
    with temporary_workspace("fourd-cameras-") as workspace:
        workspace.extract_features(pictures, KNOWN_CAMERAS, track=track)
        with workspace.open() as database:
            return [database.features(image) for image in range(len(pictures))]
