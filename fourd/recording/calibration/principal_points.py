"""Detection of principal points that are mirrored about the image centre.

Programs that rotate a calibration by 90 degrees can mirror the principal point. A rotation by 90 degrees swaps the
image's axes and reverses one of them. If a program swaps the principal point's coordinates but reverses neither, the
principal point is mirrored along one axis. Focal lengths and poses are still correct. The error of the principal point
is twice its distance from the image centre along the mirrored axis, often 10 pixels or more.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from fourd.base.cameras import Camera
from fourd.recording.calibration.checks.match_score import MatchScore, score_matches
from fourd.recording.calibration.matching import Matches
from fourd.recording.calibration.residuals import Pair, Residuals, compute_residuals

MAX_COMBINATIONS = 1024
MAX_GOOD_PX = 3.0
MAX_PAIR_PX = 30.0
"""Upper limit, in pixels, to which the residual of a camera pair is clamped. A larger residual means that the pair's
matches are wrong, so it does not show which principal points are correct."""
MIN_GAIN = 2.0
"""A choice of mirrored principal points is clear only if mirroring reduces the mean residual of the camera pairs by at
least this multiple of the typical residual. The typical residual is the median of the pairs' residuals with the chosen
principal points."""
MIN_LEAD = 0.5
"""Minimum difference between the mean residuals of the second best and the best combination of the cameras' principal
points, as a multiple of the typical residual (see MIN_GAIN)."""


@dataclass(frozen=True, eq=False)
class MirrorChoice:
    """The choice of the given or a mirrored principal point for each camera. Of all combinations, this one has the
    smallest residual.

    Attributes:
        names: choice for each camera, either "as given", "mirrored x", "mirrored y" or "mirrored both".
        cameras: the cameras with the chosen principal points.
        given: residuals of the given calibration.
        chosen: residuals of the chosen combination.
        given_px: mean, in pixels, of the camera pairs' median residuals with the given calibration. Each median is
            clamped at MAX_PAIR_PX.
        chosen_px: the same mean as ``given_px``, but with the chosen combination.
        next_px: the same mean, but with the second best combination.
        given_score: median residual of all matches, and fraction of matches with residuals of at most 3 pixels, both
            with the given calibration.
        chosen_score: the same values as ``given_score``, but with the chosen combination.
        is_clear: whether the evidence is clear. Let r be the median, over the camera pairs, of their median residuals
            with the chosen combination. Clear evidence requires that r is at most 3, and that ``next_px`` exceeds
            ``chosen_px`` by at least 0.5 * r. If the chosen combination mirrors any principal point, ``given_px`` must
            also exceed ``chosen_px`` by at least 2 * r. Differences are compared instead of ratios, because a camera
            pair with wrong matches increases all means by the same amount.
    """

    names: tuple[str, ...]
    cameras: tuple[Camera, ...]
    given: Residuals
    chosen: Residuals
    given_px: float
    chosen_px: float
    next_px: float
    given_score: MatchScore
    chosen_score: MatchScore
    is_clear: bool


def principal_point_hypotheses(camera: Camera) -> dict[str, Camera]:
    """Return four copies of the camera, one for each possible principal point, keyed by hypothesis name."""
    found = {}
    for name, x, y in (
        ("as given", False, False),
        ("mirrored x", True, False),
        ("mirrored y", False, True),
        ("mirrored both", True, True),
    ):
        intrinsics = camera.intrinsics.copy()
        if x:
            intrinsics[0, 2] = camera.width - intrinsics[0, 2]
        if y:
            intrinsics[1, 2] = camera.height - intrinsics[1, 2]
        found[name] = replace(camera, intrinsics=intrinsics)
    return found


def choose_principal_points(matches: Mapping[Pair, Matches], cameras: Sequence[Camera]) -> MirrorChoice:
    """Choose, for each camera, the given or a mirrored principal point, such that the epipolar residual is smallest.

    The matched images must show the same field of view as the images from which the cameras were calibrated. They may
    have another size, but they must not be cropped off-centre, because such a crop moves the image centre.

    Args:
        matches: matches of each camera pair, in pixels of the distorted images.
        cameras: at most 5 cameras, which give 4^5 combinations.

    Raises:
        ValueError: if there are more than 5 cameras, or no pair has enough matches.
    """
    if 4 ** len(cameras) > MAX_COMBINATIONS:
        raise ValueError(f"cameras: expected at most 5, got {len(cameras)}; pass fewer cameras")
    options = [principal_point_hypotheses(camera) for camera in cameras]
    given = compute_residuals(matches, cameras)
    if not given.pairs:
        raise ValueError("matches: expected a camera pair with at least 8 matches, got none; add frames")
    medians = {
        (pair, first_name, second_name): _pair_median(matches, cameras, pair, first, second)
        for pair in given.pairs
        for first_name, first in options[pair[0]].items()
        for second_name, second in options[pair[1]].items()
    }
    ranked = sorted(
        (_capped_mean([medians[pair, names[pair[0]], names[pair[1]]] for pair in given.pairs]), names)
        for names in product(*options)
    )
    best, names = ranked[0]
    chosen = tuple(option[name] for option, name in zip(options, names, strict=True))
    given_px = _capped_mean(given.pairs.values())
    after, next_px = compute_residuals(matches, chosen), ranked[1][0]
    typical = float(np.median(list(after.pairs.values())))
    gains = set(names) == {"as given"} or given_px - best >= MIN_GAIN * typical
    is_clear = next_px - best >= MIN_LEAD * typical and typical <= MAX_GOOD_PX and gains
    scores = score_matches(matches, cameras), score_matches(matches, chosen)
    return MirrorChoice(names, chosen, given, after, given_px, best, next_px, *scores, is_clear)


def _capped_mean(medians: Iterable[float]) -> float:
    return float(np.minimum(list(medians), MAX_PAIR_PX).mean())


def _pair_median(
    matches: Mapping[Pair, Matches], cameras: Sequence[Camera], pair: Pair, first: Camera, second: Camera
) -> float:
    """Return the median residual of a camera pair after replacing its two cameras by ``first`` and ``second``."""
    changed = list(cameras)
    changed[pair[0]], changed[pair[1]] = first, second
    return compute_residuals({pair: matches[pair]}, changed).pairs[pair]
