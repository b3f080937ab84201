"""Matches between the cameras of a capture: feature matches, and patch matches on the ground for wide baselines."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.progress import Track, untracked
from fourd.recording.calibration.matching import Matches, verify_matches
from fourd.recording.calibration.plane_matching import PlanePatch, match_on_plane
from fourd.recording.calibration.residuals import MIN_MATCHES, MIN_PAIRS, Pair, match_pairs
from fourd.recording.capture.focus import find_focus

Picture = NDArray[np.uint8]

MIN_FEATURE_MATCHES = 20
"""Minimum number of feature matches of a camera pair.

It excludes wrong matches between distant cameras. In one capture, repeated patterns gave 8 wrong matches that all fit
one homography.
"""
NO_MATCHES = Matches(np.zeros((0, 2)), np.zeros((0, 2)))
GROUND_HEIGHTS_M = (0.0, -0.02, 0.02)
"""Heights z, in metres, of the horizontal planes on which ground patches are matched.

Ground matching tries the planes in this order until there are enough matches.
"""
GROUND_HALF_SIDE_M = 2.5
METRIC_DISTANCES_M = (0.5, 50.0)
"""Smallest and largest plausible distance, in metres, between two cameras. If a distance is out of this range, the
world is assumed not to be in metres."""
MIN_UPRIGHT = 0.5
"""Minimum mean z component of the cameras' up directions in a world with z up."""
MAX_RASTER_PX = 2000


def match_cameras(
    pictures_by_frame: Sequence[Sequence[Picture]], cameras: Sequence[Camera], track: Track | None = None
) -> dict[Pair, Matches]:
    """Find corresponding points between the images of camera pairs, in all given frames.

    Features are matched first. Camera pairs with fewer than 20 feature matches are treated as unmatched. If wide
    baselines leave a camera with fewer than two matched pairs, all its pairs are also matched on the ground, provided
    that the world is in metres with z up. The ground patches lie at z = 0, in a 5 m square that is centred below the
    point that the cameras face. If the plane z = 0 gives too few matches, the planes 2 cm below and above are also
    tried. A pair with both feature matches and ground matches keeps the larger set.

    Args:
        pictures_by_frame: for each frame, one RGB image (H, W, 3) per camera, of the camera's size.
        cameras: the approximate calibration; it guides the search for matches but does not determine the positions of
            the matches.
        track: progress callback.

    Returns:
        The matches of each pair, in pixels of the distorted images.

    Raises:
        ValueError: if an image does not have its camera's size.
    """
    track = track or untracked
    matches: dict[Pair, Matches] = {}
    for frame in track(range(len(pictures_by_frame)), len(pictures_by_frame), "features"):
        _append(matches, match_pairs(pictures_by_frame[frame], cameras))
    matches = {pair: found if len(found) >= MIN_FEATURE_MATCHES else NO_MATCHES for pair, found in matches.items()}
    matched = [pair for pair, found in matches.items() if len(found)]
    isolated = {index for index in range(len(cameras)) if sum(index in pair for pair in matched) < MIN_PAIRS}
    pairs = [pair for pair in matches if set(pair) & isolated]
    patches = _ground_patches(cameras)
    for number in track(range(len(pairs)), len(pairs), "ground") if patches else ():
        pair = pairs[number]
        matches[pair] = max(matches[pair], _match_on_ground(pictures_by_frame, cameras, pair, patches), key=len)
    return matches


def _match_on_ground(
    pictures_by_frame: Sequence[Sequence[Picture]],
    cameras: Sequence[Camera],
    pair: Pair,
    patches: Sequence[PlanePatch],
) -> Matches:
    i, j = pair
    matches: dict[Pair, Matches] = {}
    for patch in patches:
        for pictures in pictures_by_frame:
            found = match_on_plane(pictures[i], pictures[j], (cameras[i], cameras[j]), patch)
            _append(matches, {pair: verify_matches(found, cameras[i], cameras[j])})
        if len(matches[pair]) >= MIN_MATCHES:
            break
    return matches[pair]


def _append(matches: dict[Pair, Matches], more: Mapping[Pair, Matches]) -> None:
    for pair, found in more.items():
        matches[pair] = matches[pair].concatenate(found) if pair in matches else found


def _ground_patches(cameras: Sequence[Camera]) -> list[PlanePatch]:
    """Return squares on the ground below the point that the cameras face; none if the world is not in metres with z
    up."""
    distances = [float(np.linalg.norm(a.centre - b.centre)) for a, b in combinations(cameras, 2)]
    up = float(np.mean([-camera.rotation[1, 2] for camera in cameras]))
    focus = find_focus(list(cameras))
    least, most = METRIC_DISTANCES_M
    if focus is None or not distances or not (least <= min(distances) and max(distances) <= most and up >= MIN_UPRIGHT):
        return []
    ranges = [float(np.linalg.norm(camera.centre - focus)) for camera in cameras]
    px_per_m = float(
        np.median([camera.intrinsics[0, 0] / distance for camera, distance in zip(cameras, ranges, strict=True)])
    )
    resolution = min(px_per_m, MAX_RASTER_PX / (2 * GROUND_HALF_SIDE_M))
    x, y = focus[0] - GROUND_HALF_SIDE_M, focus[1] + GROUND_HALF_SIDE_M
    right, down = np.array([1.0, 0, 0]), np.array([0, -1.0, 0])
    side = 2 * GROUND_HALF_SIDE_M
    return [PlanePatch(np.array([x, y, z]), right, down, side, side, resolution) for z in GROUND_HEIGHTS_M]
