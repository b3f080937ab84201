"""Principal points mirrored about the picture's centre, an error of programs that rotate a calibration by 90 degrees.

Such a rotation swaps the picture's axes and reverses one of them. A program that swaps the numbers without reversing
keeps focal lengths and poses right, but mirrors the principal point along one axis: an error of twice its distance
from the centre, often 10 pixels or more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from fourd.calibration.matching import Matches
from fourd.calibration.residuals import Pair, Residuals, compute_residuals
from fourd.cameras import Camera

MAX_COMBINATIONS = 1024
MAX_GOOD_PX = 3.0
MIN_GAIN = 3.0
"""Minimum ratio of the given calibration's residual to the mirrored one's."""
MIN_LEAD = 1.5


@dataclass(frozen=True, eq=False)
class MirrorChoice:
    """Which cameras' principal points are mirrored.

    Attributes:
        names: by camera "as given", "mirrored x", "mirrored y" or "mirrored both".
        cameras: the cameras with the chosen principal points.
        given, chosen: residuals of the calibration as given and as chosen.
        given_px, chosen_px: means of the pairs' medians.
        next_px: mean of the best other combination.
        is_clear: whether the choice is within 3 pixels, the next combination is at least 1.5 times as far off and, for
            a mirrored choice, the given calibration is at least 3 times as far off.
    """

    names: tuple[str, ...]
    cameras: tuple[Camera, ...]
    given: Residuals
    chosen: Residuals
    given_px: float
    chosen_px: float
    next_px: float
    is_clear: bool


def principal_point_hypotheses(camera: Camera) -> dict[str, Camera]:
    """The camera with its principal point as given and mirrored about the picture's centre, by name."""
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
    """Score all combinations of mirrored principal points by matches in pixels of the distorted pictures.

    The pictures have the calibration's size or are resized without a crop, so that both have the same centre. At most
    5 cameras (4^5 combinations).

    Raises:
        ValueError: for more cameras, or when no pair has enough matches.
    """
    if 4 ** len(cameras) > MAX_COMBINATIONS:
        raise ValueError(f"cameras: expected at most 5, got {len(cameras)}; take a part of them")
    options = [principal_point_hypotheses(camera) for camera in cameras]
    given = compute_residuals(matches, cameras)
    if not given.pairs:
        raise ValueError("matches: expected a pair of cameras with at least 8, got none; add frames or other matches")
    medians = {
        (pair, first_name, second_name): _pair_median(matches, cameras, pair, first, second)
        for pair in given.pairs
        for first_name, first in options[pair[0]].items()
        for second_name, second in options[pair[1]].items()
    }
    ranked = sorted(
        (float(np.mean([medians[pair, names[pair[0]], names[pair[1]]] for pair in given.pairs])), names)
        for names in product(*options)
    )
    best, names = ranked[0]
    chosen = tuple(option[name] for option, name in zip(options, names, strict=True))
    given_px = float(np.mean(list(given.pairs.values())))
    leads = ranked[1][0] >= MIN_LEAD * best
    is_given = set(names) == {"as given"}
    is_clear = leads and best <= MAX_GOOD_PX and (is_given or given_px >= MIN_GAIN * best)
    return MirrorChoice(
        names, chosen, given, compute_residuals(matches, chosen), given_px, best, ranked[1][0], is_clear
    )


def _pair_median(
    matches: Mapping[Pair, Matches], cameras: Sequence[Camera], pair: Pair, first: Camera, second: Camera
) -> float:
    """Median residual of a pair with its two cameras replaced."""
    changed = list(cameras)
    changed[pair[0]], changed[pair[1]] = first, second
    return compute_residuals({pair: matches[pair]}, changed).pairs[pair]
