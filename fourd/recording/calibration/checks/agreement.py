"""Check of a calibration with the epipolar residuals of feature matches between the capture's images."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera, equal_positions
from fourd.base.progress import Track
from fourd.recording.calibration.camera_matching import MIN_FEATURE_MATCHES, match_cameras
from fourd.recording.calibration.checks.evidence import (
    MIN_JUDGED,
    CameraEvidence,
    contradicting_matches,
    gather_evidence,
    with_baselines,
)
from fourd.recording.calibration.checks.match_score import MatchScore, score_matches
from fourd.recording.calibration.checks.mixups import find_mixups
from fourd.recording.calibration.colours import ColourDifferences, measure_colours, sample_colours
from fourd.recording.calibration.matching import Matches, distort_points
from fourd.recording.calibration.residuals import (
    ALL_PAIRS_CAMERAS,
    MAX_GOOD_PX,
    MIN_MATCHES,
    Pair,
    compute_residuals,
    match_pairs,
)
from fourd.recording.capture.layout import EXTRINSICS_NAME, sample_indices
from fourd.recording.capture.reader import open_capture

Picture = NDArray[np.uint8]

FEW_CAMERAS = 5
FEW_CAMERAS_FRAMES = 3
MAX_PICTURE_PIXELS = 2.1e6
"""Maximum number of pixels per image. Larger images are reduced."""
MAX_FRAME_PIXELS = 12e6
"""Maximum total number of pixels in all cameras' images of one frame. If there are more, all images are reduced.

This limits the time of the check to a few seconds for a ring of cameras.
"""
MIN_SHARE = 0.5
"""Minimum fraction of matches within 3 pixels of their epipolar lines. It is below 2/3, because even with a correct
calibration, a third of the matches can be wrong."""


@dataclass(frozen=True, eq=False)
class CaptureMatches:
    """Feature matches between the cameras of a capture.

    Attributes:
        names: the cameras' names.
        cameras: the cameras of the stored images, with distortion.
        matches: matches of each camera pair, in pixels of the stored images.
        colours: differences between the cameras' colours at the matches of one frame.
    """

    names: tuple[str, ...]
    cameras: tuple[Camera, ...]
    matches: dict[Pair, Matches]
    colours: ColourDifferences | None = None


@dataclass(frozen=True)
class Agreement:
    """Result of the check of a calibration.

    Attributes:
        score: median residual and fraction of agreeing matches, or None if no camera pair has enough matches.
        evidence: what the matches say about each camera.
        pairs: number of camera pairs with enough matches.
        matches: total number of matches.
        mixups: one line for each camera with upside-down images, and one for each pair of cameras with exchanged
            calibrations.
        suspicious: names of the cameras whose calibration is probably wrong: they disagree with the others in many
            matches, or two of them are at equal positions.
        warnings: the lines of ``mixups``. If ``mixups`` is empty, one line for each camera that disagrees with the
            others, or one line if all cameras disagree.
        colours: differences between the cameras' colours at matching points.
    """

    score: MatchScore | None
    evidence: tuple[CameraEvidence, ...]
    pairs: int
    matches: int
    mixups: tuple[str, ...]
    suspicious: tuple[str, ...]
    warnings: tuple[str, ...]
    colours: ColourDifferences | None = None

    @property
    def worst(self) -> CameraEvidence | None:
        """The verified camera with the largest median residual, among those with enough matches for a figure."""
        judged = [each for each in self.evidence if each.is_verified and each.matches >= MIN_JUDGED]
        return max(judged, key=lambda each: each.median_px, default=None)

    @property
    def unverified(self) -> tuple[CameraEvidence, ...]:
        """The cameras whose calibration the matches do not confirm."""
        return tuple(each for each in self.evidence if not each.is_verified)


def match_capture(path: Path | str, track: Track | None = None) -> CaptureMatches:
    """Find corresponding points between the images of a capture's cameras.

    For up to 5 cameras, 3 frames are matched; for more cameras, only the middle frame.

    Args:
        path: the capture's folder.
        track: progress callback.

    Raises:
        UserError: if the capture cannot be opened; see :func:`fourd.recording.capture.open_capture`.
    """
    with open_capture(path, mattes=False) as whole:
        largest = max(camera.width * camera.height for camera in whole.cameras)
        max_pixels = min(MAX_PICTURE_PIXELS, MAX_FRAME_PIXELS / len(whole.cameras))
    with open_capture(path, mattes=False, scale=min(1.0, float(np.sqrt(max_pixels / largest)))) as capture:
        has_few = len(capture.cameras) <= FEW_CAMERAS
        frames = sample_indices(capture.frame_count, FEW_CAMERAS_FRAMES) if has_few else [capture.frame_count // 2]
        pictures = [[capture.image(camera, frame) for camera in range(len(capture.cameras))] for frame in frames]
    cameras = capture.distorted_cameras
    reduced = match_cameras(pictures, capture.cameras, track)
    reduced |= _match_unmatched(pictures[0], capture.cameras, reduced)
    matches = {}
    for (i, j), found in reduced.items():
        first, second = (
            distort_points(cameras[index], xy * (cameras[index].width / capture.cameras[index].width))
            for index, xy in ((i, found.first_px), (j, found.second_px))
        )
        matches[i, j] = Matches(first, second)
    own = reduced if len(pictures) == 1 else match_cameras(pictures[:1], capture.cameras)
    colours = measure_colours(sample_colours(pictures[0], own), range(len(cameras)))
    return CaptureMatches(tuple(capture.names), cameras, matches, colours)


def _match_unmatched(
    pictures: Sequence[Picture], cameras: Sequence[Camera], matches: Mapping[Pair, Matches]
) -> dict[Pair, Matches]:
    """Find the cameras that have too few matches in every pair, and match each of them again, this time with all other
    cameras. They may lack matches because their calibrations are wrong: each camera was first matched only with the
    cameras that are its neighbours according to the calibration.

    This is done only if at least two cameras, but at most a quarter of all cameras, have too few matches. It is not
    needed for up to 8 cameras, because all their pairs have been matched.
    """
    used = {index for pair, found in matches.items() if len(found) >= MIN_MATCHES for index in pair}
    lone = [index for index in range(len(cameras)) if index not in used]
    if len(cameras) <= ALL_PAIRS_CAMERAS or not 2 <= len(lone) <= len(cameras) / 4:
        return {}
    pairs = [(i, j) for i, j in combinations(range(len(cameras)), 2) if {i, j} & set(lone)]
    found = match_pairs(pictures, cameras, pairs=pairs)
    return {pair: some for pair, some in found.items() if len(some) >= MIN_FEATURE_MATCHES}


def check_agreement(path: Path | str, track: Track | None = None) -> Agreement:
    """Compute the epipolar residuals of a capture's calibration; see :func:`match_capture` for the arguments."""
    found = match_capture(path, track)
    return replace(assess_agreement(path, found), colours=found.colours)


def assess_agreement(path: Path | str, found: CaptureMatches) -> Agreement:
    """Compute the epipolar residuals of the matches ``found`` in the capture ``path``."""
    matches = with_baselines(found.matches, found.cameras)
    residuals = compute_residuals(matches, found.cameras)
    count = sum(map(len, matches.values()))
    evidence = gather_evidence(found.names, matches, found.cameras)
    equal = {index for pair in equal_positions(found.cameras) for index in pair}
    if not residuals.pairs:
        return Agreement(None, evidence, 0, count, (), _names(found, equal), ())
    score = score_matches(matches, found.cameras)
    file = Path(path) / EXTRINSICS_NAME
    mixups = tuple(f"{path}: {each.describe(found.names)}" for each in find_mixups(matches, found.cameras))
    bad = [index for index in residuals.bad if contradicting_matches(residuals, index) >= MIN_JUDGED]
    warnings = list(mixups) or [
        f"{file}: camera '{found.names[index]}' disagrees with the others by {residuals.cameras[index] or 0:.1f} px; "
        "calibrate it again, or exclude it with --views"
        for index in bad
    ]
    if not warnings and is_disagreeing(score) and len(residuals.pairs) > 1:
        warnings.append(
            f"{file}: the cameras disagree with each other ({score}); the calibration may belong to other cameras or "
            "another recording; fourd make tries to refine it; if that fails, calibrate again, or run fourd import "
            "again to check for resized images and mirrored principal points"
        )
    suspicious = _names(found, equal | set(bad))
    return Agreement(score, evidence, len(residuals.pairs), count, mixups, suspicious, tuple(warnings))


def _names(found: CaptureMatches, cameras: set[int]) -> tuple[str, ...]:
    return tuple(found.names[index] for index in sorted(cameras))


def is_disagreeing(score: MatchScore) -> bool:
    """Return whether most matches contradict the calibration."""
    return score.median_px > MAX_GOOD_PX or score.share < MIN_SHARE
