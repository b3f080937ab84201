"""Detection of two mistakes in captures: cameras with exchanged calibrations, and cameras with upside-down images.

A hypothesis assumes one of the two mistakes for one or two cameras, and corrects it. It is accepted if these cameras'
matches have large residuals with the given calibration and small residuals after the correction.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from fourd.base.cameras import Camera
from fourd.recording.calibration.checks.match_score import MatchScore, score_matches
from fourd.recording.calibration.matching import Matches
from fourd.recording.calibration.residuals import MAX_GOOD_PX, Pair

MIN_MATCHES = 16
MIN_SHARE = 0.6
"""A hypothesis (that two calibrations are exchanged, or that a camera's images are upside down) is accepted only if,
after the correction, at least this fraction of the matches has small residuals."""
MAX_SHARE_RATIO = 0.6
"""A hypothesis is accepted only if the fraction of matches with small residuals before the correction is at most this
multiple of the fraction after the correction."""
MAX_MIXUPS = 4
MAX_SUSPECTS = 8


@dataclass(frozen=True, eq=False)
class Mixup:
    """One camera whose images are upside down, or two cameras with exchanged calibrations.

    Attributes:
        cameras: indices of the camera, or of the two cameras.
        before: score of the matches of ``cameras`` with the calibration as given.
        after: score of the same matches after the correction.
    """

    cameras: tuple[int, ...]
    before: MatchScore
    after: MatchScore

    def describe(self, names: Sequence[str]) -> str:
        """Return one line with the cameras' names, the evidence and the fix."""
        chosen = [names[index] for index in self.cameras]
        if len(chosen) == 1:
            return (
                f"camera '{chosen[0]}': its images look upside down ({self.before}; turned by 180 degrees: "
                f"{self.after}); turn its images, or calibrate it with images of this orientation"
            )
        return (
            f"cameras '{chosen[0]}' and '{chosen[1]}': their calibrations look exchanged ({self.before}; exchanged "
            f"back: {self.after}); exchange the names of the two cameras in the calibration, or of their images"
        )


def find_mixups(matches: Mapping[Pair, Matches], cameras: Sequence[Camera]) -> list[Mixup]:
    """Find cameras with exchanged calibrations or upside-down images. The clearest case comes first.

    Args:
        matches: matches of each camera pair, in pixels of the stored images.
        cameras: the cameras of the stored images.
    """
    current, lenses = dict(matches), list(cameras)
    found: list[Mixup] = []
    while len(found) < MAX_MIXUPS:
        mixups = [mixup for mixup in _hypotheses(current, lenses) if _is_accepted(mixup)]
        if not mixups:
            break
        best = max(mixups, key=lambda mixup: (mixup.after.share - mixup.before.share) * mixup.after.count)
        current, lenses = _apply(best.cameras, current, lenses)
        found.append(best)
    return found


def suspects(matches: Mapping[Pair, Matches], cameras: Sequence[Camera]) -> list[int]:
    """Return the indices of the cameras for which most matches have large residuals, those with the largest residuals
    first."""
    shares = []
    for index in range(len(cameras)):
        score = score_matches(_touching(matches, (index,)), cameras)
        if score.count >= MIN_MATCHES and score.share < MIN_SHARE:
            shares.append((score.share, index))
    return [index for _, index in sorted(shares)[:MAX_SUSPECTS]]


def _hypotheses(matches: Mapping[Pair, Matches], cameras: Sequence[Camera]) -> Iterator[Mixup]:
    bad = suspects(matches, cameras)
    sizes = [(camera.width, camera.height) for camera in cameras]
    exchanges = [(i, j) for i, j in combinations(sorted(bad), 2) if sizes[i] == sizes[j]]
    for chosen in [*((index,) for index in bad), *exchanges]:
        touched = _touching(matches, chosen)
        yield Mixup(chosen, score_matches(touched, cameras), score_matches(*_apply(chosen, touched, cameras)))


def _is_accepted(mixup: Mixup) -> bool:
    before, after = mixup.before, mixup.after
    is_good = after.count >= MIN_MATCHES and after.median_px <= MAX_GOOD_PX and after.share >= MIN_SHARE
    return is_good and before.share <= MAX_SHARE_RATIO * after.share


def _apply(
    chosen: Sequence[int], matches: Mapping[Pair, Matches], cameras: Sequence[Camera]
) -> tuple[dict[Pair, Matches], list[Camera]]:
    """Return the matches and the cameras after the correction of one mistake. If ``chosen`` is one camera, the
    positions of the matches in its images are turned by 180 degrees about the image centre. If ``chosen`` is two
    cameras, their calibrations are exchanged."""
    if len(chosen) == 2:
        exchanged = list(cameras)
        i, j = chosen
        exchanged[i], exchanged[j] = cameras[j], cameras[i]
        return dict(matches), exchanged
    (index,) = chosen
    turned = {}
    size = np.array([cameras[index].width, cameras[index].height], np.float64)
    for (i, j), found in matches.items():
        first = size - found.first_px if i == index else found.first_px
        second = size - found.second_px if j == index else found.second_px
        turned[i, j] = Matches(first, second)
    return turned, list(cameras)


def _touching(matches: Mapping[Pair, Matches], cameras: Sequence[int]) -> dict[Pair, Matches]:
    return {pair: found for pair, found in matches.items() if set(pair) & set(cameras) and len(found)}
