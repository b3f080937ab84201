"""Principal points on the wrong side of the picture's middle: what turning a calibration by 90 degrees can do.

A picture that is turned by a quarter has its axes swapped and one of them reversed. Where a program
swaps the calibration's numbers and forgets to reverse, the focal lengths and poses are right and the
principal point is mirrored along one axis: twice its distance from the middle off, often 10 pixels or more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from fourd.calibration.matching import Matches
from fourd.calibration.residuals import Pair, Residuals, residuals_of
from fourd.cameras import Camera

MOST_COMBINATIONS = 1024
WORST_PX = 3.0
LEAST_GAIN = 3.0
"""Times by which the mirrored calibration must agree better than the given one."""
LEAD = 1.5


@dataclass(frozen=True, eq=False)
class MirrorChoice:
    """Which cameras' principal points are mirrored.

    Attributes:
        names: by camera "as given", "mirrored x", "mirrored y" or "mirrored both".
        lenses: the cameras so.
        given, chosen: residuals of the calibration as given and as chosen.
        given_px, chosen_px: means of the pairs' medians.
        next_px: the same of the best other combination.
        is_clear: whether the chosen one is good to 3 pixels, 3 times as good as the given one and 1.5 times
            as good as any other; where the given one is chosen, only the last.
    """

    names: tuple[str, ...]
    lenses: tuple[Camera, ...]
    given: Residuals
    chosen: Residuals
    given_px: float
    chosen_px: float
    next_px: float
    is_clear: bool


def principal_point_hypotheses(lens: Camera) -> dict[str, Camera]:
    """The camera with its principal point as given and mirrored about the picture's middle, by name."""
    found = {}
    for name, x, y in (
        ("as given", False, False),
        ("mirrored x", True, False),
        ("mirrored y", False, True),
        ("mirrored both", True, True),
    ):
        intrinsics = lens.intrinsics.copy()
        if x:
            intrinsics[0, 2] = lens.width - intrinsics[0, 2]
        if y:
            intrinsics[1, 2] = lens.height - intrinsics[1, 2]
        found[name] = replace(lens, intrinsics=intrinsics)
    return found


def pick_centres(matches: Mapping[Pair, Matches], lenses: Sequence[Camera]) -> MirrorChoice:
    """Try all combinations of mirrored principal points against matches in the pictures' own pixels.

    ``lenses`` have the size that the calibration was made for, or were resized without a crop, so
    that the picture's middle is still the calibration's. At most 5 cameras (4^5 combinations): take a
    part of a larger set. Raises ValueError for more, and where no pair has enough matches.
    """
    if 4 ** len(lenses) > MOST_COMBINATIONS:
        raise ValueError(f"lenses: expected at most 5 cameras, got {len(lenses)}; take a part of them")
    options = [principal_point_hypotheses(lens) for lens in lenses]
    given = residuals_of(matches, lenses)
    if not given.pairs:
        raise ValueError("matches: expected a pair of cameras with at least 8, got none; add frames or other matches")
    medians = {
        (pair, mine, its): residuals_of({pair: matches[pair]}, _with(lenses, {pair[0]: one, pair[1]: other})).pairs[
            pair
        ]
        for pair in given.pairs
        for mine, one in options[pair[0]].items()
        for its, other in options[pair[1]].items()
    }
    tried = sorted(
        (float(np.mean([medians[pair, names[pair[0]], names[pair[1]]] for pair in given.pairs])), names)
        for names in product(*options)
    )
    best, names = tried[0]
    cameras = tuple(option[name] for option, name in zip(options, names, strict=True))
    given_px = _mean(given)
    is_lead = tried[1][0] >= LEAD * best
    is_given = set(names) == {"as given"}
    is_clear = is_lead and best <= WORST_PX and (is_given or given_px >= LEAST_GAIN * best)
    return MirrorChoice(names, cameras, given, residuals_of(matches, cameras), given_px, best, tried[1][0], is_clear)


def _with(lenses: Sequence[Camera], others: Mapping[int, Camera]) -> list[Camera]:
    return [others.get(index, lens) for index, lens in enumerate(lenses)]


def _mean(found: Residuals) -> float:
    return float(np.mean(list(found.pairs.values())))
