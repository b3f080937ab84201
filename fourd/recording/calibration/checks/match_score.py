"""Robust summary of epipolar residuals: the median, and the fraction of matches with small residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fourd.base.cameras import Camera
from fourd.recording.calibration.matching import Matches
from fourd.recording.calibration.residuals import MAX_GOOD_PX, Pair, epipolar_distances


@dataclass(frozen=True)
class MatchScore:
    """Summary of the distances of matches from their epipolar lines.

    The median is used instead of the mean, because wrong matches affect the mean distance more than the calibration
    does. If the cameras are 90 degrees apart, a third of the feature matches can be wrong.

    Attributes:
        median_px: median distance in pixels, or NaN if there are no matches.
        share: fraction of the matches within 3 pixels of their epipolar lines, or 0 if there are no matches.
        count: number of matches.
    """

    median_px: float
    share: float
    count: int

    def __str__(self) -> str:
        return f"median {self.median_px:.2f} px, {self.share:.0%} of {self.count} matches within {MAX_GOOD_PX:g} px"


def score_matches(matches: Mapping[Pair, Matches], cameras: Sequence[Camera]) -> MatchScore:
    """Compute the score of ``cameras`` from matches, whose positions are in pixels of the distorted images."""
    parts = [np.abs(epipolar_distances(found, cameras[i], cameras[j])) for (i, j), found in matches.items()]
    distances = np.concatenate([np.zeros(0), *parts])
    if not len(distances):
        return MatchScore(float("nan"), 0.0, 0)
    return MatchScore(float(np.median(distances)), float(np.mean(distances <= MAX_GOOD_PX)), len(distances))
