"""Repair of a given calibration. Corrections are kept only if they reduce the residuals of held-out matches.

The cameras are fitted to the matches of two thirds of the feature tracks. The matches of the other tracks are held out:
their residuals determine whether a correction is kept. The first correction reverses an error of programs that rotate
calibrations by 90 degrees: it mirrors principal points about the image centre (see
:mod:`fourd.recording.calibration.principal_points`). Three bundle adjustments follow. The first changes only poses, the
second also focal lengths, and the third also principal points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.recording.calibration.adjustment.adjust import adjust_to_matches
from fourd.recording.calibration.adjustment.solver import Prior
from fourd.recording.calibration.adjustment.tracks import FrameMatches
from fourd.recording.calibration.checks.match_score import MatchScore, score_matches
from fourd.recording.calibration.matching import Matches, undistort_points
from fourd.recording.calibration.principal_points import MAX_COMBINATIONS, choose_principal_points
from fourd.recording.calibration.residuals import Pair, compute_residuals
from fourd.recording.capture.focus import viewing_centre
from fourd.recording.stereo.features import Features

Feature = tuple[int, int]
"""Index of a camera, and index of a feature in the camera's image."""

HELD_OUT = 3
"""One of every HELD_OUT feature tracks is held out: the cameras are not fitted to its matches, so that the residuals of
these matches show whether a correction is right."""
MIN_MATCHES = 60
"""Minimum number of matches that a repair needs."""
MIN_GAIN = 0.9
"""A correction is kept only if the median residual of the held-out matches after the correction is at most this
multiple of the median residual before the correction."""
MIN_GAIN_PX = 0.1
"""A correction is kept only if it decreases the median residual of the held-out matches by at least this number of
pixels. Even if a calibration is good, a correction decreases this median by up to 0.04 pixels, because it follows the
noise of the matches."""
BAND = 0.03
"""Maximum distance of a match from its epipolar line, as a fraction of the longest image side of all cameras."""
ROTATION_DEG, POSITION, FOCAL, PRINCIPAL = 1.0, 0.01, 0.01, 0.01
"""Assumed standard deviations of the errors in the given calibration. ROTATION_DEG is in degrees. POSITION is a
fraction of the distance between the camera and the scene's centre. FOCAL is a fraction of the given focal length.
PRINCIPAL is a fraction of the longest image side of all cameras."""
DISTORTION_ROUNDS = 3
"""Number of rounds of a bundle adjustment that changes intrinsics. Each round undistorts the matches with the latest
intrinsics."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A correction that was tried.

    Attributes:
        name: description of the corrected quantities.
        score: score of the held-out matches with the corrected cameras.
        is_kept: whether the correction is part of the result.
    """

    name: str
    score: MatchScore
    is_kept: bool


@dataclass(frozen=True, eq=False)
class Repair:
    """Result of :func:`repair_cameras`.

    Attributes:
        cameras: the cameras with the kept corrections.
        before: score of the held-out matches with the given cameras.
        after: score of the held-out matches with ``cameras``.
        trials: the corrections in the order in which they were tried.
    """

    cameras: tuple[Camera, ...]
    before: MatchScore
    after: MatchScore
    trials: tuple[Trial, ...]

    @property
    def is_changed(self) -> bool:
        """Whether any correction is kept."""
        return any(trial.is_kept for trial in self.trials)


def repair_cameras(cameras: Sequence[Camera], matches: Mapping[Pair, Matches]) -> Repair:
    """Try corrections of ``cameras``, and keep those that reduce the residuals of held-out matches.

    Args:
        cameras: the given cameras, with distortion.
        matches: matches of each camera pair, in pixels of the distorted images.
    """
    fitted, held_out = split_matches(matches, len(cameras))
    given = tuple(cameras)
    before = score_matches(held_out, given)
    trials: list[Trial] = []
    if before.count * HELD_OUT < MIN_MATCHES:
        return Repair(given, before, before, ())
    base = best = given
    score = before
    if 4 ** len(given) <= MAX_COMBINATIONS and compute_residuals(fitted, given).pairs:
        found = choose_principal_points(fitted, given)
        if set(found.names) != {"as given"}:
            now = score_matches(held_out, found.cameras)
            is_kept = found.is_clear and _is_better(now, score)
            trials.append(Trial("mirrored principal points", now, is_kept))
            if is_kept:
                base, best, score = found.cameras, found.cameras, now
    for name, has_focal, has_principal in (
        ("poses", False, False),
        ("poses and focal lengths", True, False),
        ("poses, focal lengths and principal points", True, True),
    ):
        adjusted = _adjust(base, fitted, has_focal, has_principal)
        now = score_matches(held_out, adjusted)
        is_kept = _is_better(now, score)
        trials.append(Trial(name, now, is_kept))
        if is_kept:
            best, score = adjusted, now
    return Repair(best, before, score, tuple(trials))


def split_matches(matches: Mapping[Pair, Matches], cameras: int) -> tuple[dict[Pair, Matches], dict[Pair, Matches]]:
    """Split the matches into those for the fit and the held-out ones.

    Every track belongs to one of the two sets. The features of a match can be in different tracks, because not every
    match joins tracks (see :func:`_label_tracks`). If one of these tracks is for the fit and the other is held out, the
    match belongs to neither set. Therefore, no feature belongs to both sets.
    """
    _, rows = _index_features(matches, cameras)
    tracks = _label_tracks(rows)
    # Tracks are put in random order, so that the held-out tracks are a random sample.
    order = np.random.default_rng(0).permutation(max(tracks.values(), default=0) + 1)
    fitted, held_out = {}, {}
    for (i, j), found in matches.items():
        ends = [(i, first) for first in rows[i, j][:, 0]], [(j, second) for second in rows[i, j][:, 1]]
        first, second = (np.array([order[tracks[end]] for end in side], np.intp) % HELD_OUT == 0 for side in ends)
        to_fit, is_held = ~first & ~second, first & second
        fitted[i, j] = Matches(found.first_px[to_fit], found.second_px[to_fit])
        held_out[i, j] = Matches(found.first_px[is_held], found.second_px[is_held])
    return fitted, held_out


def _label_tracks(rows: Mapping[Pair, NDArray[np.intp]]) -> dict[Feature, int]:
    """Return the index of each feature's track.

    A camera sees each point at most once, so a match joins two tracks only if no camera is in both tracks. Without this
    rule, a few wrong matches would join all tracks.
    """
    members: list[dict[int, Feature]] = []
    track: dict[Feature, int] = {}
    edges = [((i, int(a)), (j, int(b))) for (i, j), pairs in rows.items() for a, b in pairs]
    for index in np.random.default_rng(1).permutation(len(edges)):
        for end in edges[index]:
            if end not in track:
                track[end] = len(members)
                members.append({end[0]: end})
        kept, joined = (track[end] for end in edges[index])
        if kept != joined and not members[kept].keys() & members[joined].keys():
            members[kept].update(members[joined])
            track.update(dict.fromkeys(members[joined].values(), kept))
            members[joined] = {}
    return track


def _is_better(now: MatchScore, before: MatchScore) -> bool:
    largest = min(MIN_GAIN * before.median_px, before.median_px - MIN_GAIN_PX)
    return now.median_px <= largest and now.share >= before.share


def _adjust(
    given: Sequence[Camera], matches: Mapping[Pair, Matches], has_focal: bool, has_principal: bool
) -> tuple[Camera, ...]:
    """Run bundle adjustment with the initial cameras ``given`` and the matches. It changes the poses. If ``has_focal``
    is true, it also changes the focal lengths, and if ``has_principal`` is true, the principal points."""
    straight = [replace(camera, distortion=None) for camera in given]
    focus = viewing_centre(straight)
    distance = np.array([float(np.linalg.norm(camera.centre - focus)) for camera in given])
    longest = max(max(camera.width, camera.height) for camera in given)
    principal_px = PRINCIPAL * longest if has_principal else 0.0
    focal = FOCAL if has_focal else 0.0
    prior = Prior(np.radians(ROTATION_DEG), POSITION * distance, focal, principal_px=principal_px)
    now = tuple(given)
    for _ in range(DISTORTION_ROUNDS if has_focal or has_principal else 1):
        frame = _undistorted_frame(matches, now)
        found = adjust_to_matches(straight, [frame], prior, BAND)
        now = tuple(
            replace(camera, distortion=lens.distortion) for camera, lens in zip(found.cameras, given, strict=True)
        )
    return now


def _undistorted_frame(matches: Mapping[Pair, Matches], cameras: Sequence[Camera]) -> FrameMatches:
    """Convert matches to a FrameMatches, and remove the lens distortion of ``cameras`` from the features' positions."""
    frame, rows = _index_features(matches, len(cameras))
    features = tuple(
        Features(undistort_points(camera, each.xy_px), each.descriptors)
        for camera, each in zip(cameras, frame.features, strict=True)
    )
    return FrameMatches(features, rows)


def _index_features(matches: Mapping[Pair, Matches], cameras: int) -> tuple[FrameMatches, dict[Pair, NDArray[np.intp]]]:
    """Give each feature an index within its camera. Matches with the same position in a camera share one feature."""
    positions = []
    for camera in range(cameras):
        parts = [found.first_px for (i, _), found in matches.items() if i == camera]
        parts += [found.second_px for (_, j), found in matches.items() if j == camera]
        positions.append(np.concatenate([np.zeros((0, 2)), *parts]))
    features, numbers = [], []
    for xy in positions:
        unique, inverse = np.unique(np.round(xy, 2), axis=0, return_inverse=True)
        features.append(Features(unique, np.zeros((len(unique), 0), np.float32)))
        numbers.append(inverse.reshape(-1).astype(np.intp))
    used = [0] * cameras
    rows: dict[Pair, list[NDArray[np.intp]]] = {pair: [] for pair in matches}
    for side in (0, 1):
        for pair, found in matches.items():
            camera = pair[side]
            rows[pair].append(numbers[camera][used[camera] : used[camera] + len(found)])
            used[camera] += len(found)
    stacked = {pair: np.column_stack(both) for pair, both in rows.items()}
    return FrameMatches(tuple(features), stacked), stacked
