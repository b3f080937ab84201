"""What feature matches say about the calibration of each camera: confirmed, contradicted, or not known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fourd.base.cameras import Camera, equal_positions
from fourd.recording.calibration.matching import Matches
from fourd.recording.calibration.residuals import MAX_GOOD_PX, MIN_MATCHES, Pair, Residuals, epipolar_distances

MIN_JUDGED = 40
"""Minimum number of matches for a figure of one camera. Between distant cameras, some tens of matches can all be
wrong."""
MIN_CONFIRMING = 0.5
"""Minimum fraction of a verified camera's matches that are in pairs which confirm its calibration."""


@dataclass(frozen=True)
class CameraEvidence:
    """The matches of one camera with the other cameras.

    A pair of cameras confirms their calibrations if its median residual is at most 3 pixels. Wrong matches rarely give
    such a median by chance, but they can give any larger one. Therefore, a camera is verified if its confirming pairs
    have at least half of its matches, and its other pairs are then not counted.

    Attributes:
        name: the camera's name.
        matches: number of matches in the confirming pairs of a verified camera. For other cameras, number of matches in
            all pairs with at least 8 matches.
        median_px: median distance of these matches from their epipolar lines in pixels, or NaN if there are none.
        is_verified: whether the confirming pairs have enough matches.
    """

    name: str
    matches: int
    median_px: float
    is_verified: bool

    def __str__(self) -> str:
        if not self.matches:
            return f"{self.name} (no matches)"
        few = ", which are too few to judge" if self.matches < MIN_JUDGED else ""
        return f"{self.name} (median {self.median_px:.1f} px over {self.matches} matches{few})"


def with_baselines(matches: Mapping[Pair, Matches], cameras: Sequence[Camera]) -> dict[Pair, Matches]:
    """Remove the matches of cameras at equal positions. Such cameras have no epipolar lines, so their matches cannot
    confirm anything."""
    equal = set(equal_positions(cameras))
    return {pair: found for pair, found in matches.items() if pair not in equal}


def gather_evidence(
    names: Sequence[str], matches: Mapping[Pair, Matches], cameras: Sequence[Camera]
) -> tuple[CameraEvidence, ...]:
    """Return the evidence for each camera.

    Args:
        names: the cameras' names.
        matches: matches of each camera pair with a baseline, in pixels of the distorted images.
        cameras: the cameras, with distortion.
    """
    distances = {
        (i, j): np.abs(epipolar_distances(found, cameras[i], cameras[j]))
        for (i, j), found in matches.items()
        if len(found) >= MIN_MATCHES
    }
    gathered = []
    for index, name in enumerate(names):
        own = [each for pair, each in distances.items() if index in pair]
        confirming = [each for each in own if np.median(each) <= MAX_GOOD_PX]
        is_verified = bool(confirming) and sum(map(len, confirming)) >= MIN_CONFIRMING * sum(map(len, own))
        pooled = np.concatenate([np.zeros(0), *(confirming if is_verified else own)])
        median = float(np.median(pooled)) if len(pooled) else float("nan")
        gathered.append(CameraEvidence(name, len(pooled), median, is_verified))
    return tuple(gathered)


def contradicting_matches(residuals: Residuals, camera: int) -> int:
    """Return the number of matches in those pairs of a camera whose median residual is above 3 pixels."""
    return sum(
        residuals.counts[pair] for pair, median in residuals.pairs.items() if camera in pair and median > MAX_GOOD_PX
    )
