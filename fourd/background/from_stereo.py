"""Background points from clean plates: features triangulated, then depth maps that agree, thinned evenly."""

from __future__ import annotations

from collections.abc import Sequence

from fourd.background.plates import PlateView
from fourd.background.stereo.colouring import coloured_points
from fourd.background.stereo.completion import filled
from fourd.background.stereo.depth_maps import LEAST_FEATURES, measured
from fourd.errors import UserError
from fourd.ply import ColouredPoints
from fourd.progress import Log, Track, untracked

LEAST_SHARE = 0.1
"""Of the plates' cells, measured."""


def seed_from_stereo(
    plates: Sequence[PlateView],
    points: int,
    *,
    fill: bool = True,
    seed: int = 0,
    workers: int = 1,
    log: Log = lambda line: None,
    track: Track = untracked,
) -> ColouredPoints:
    """Points of a still background, about one for every equal area of the pictures, with colours.

    Features of the plates are matched along epipolar lines and triangulated by COLMAP, the cameras as given. They
    and the planes that many of them lie on start a depth map of each plate (PatchMatch), of which remains what
    other plates confirm and none contradicts. The same input and seed give the same points.

    Args:
        plates: at least two.
        points: wanted number, at least 1; fewer where the plates show less.
        fill: whether what no two plates show alike gets points too, at depths continued from around it.
        seed: of all that is random.
        workers: processes.
        say: told how many points were found, a line each.
        track: for progress.

    Returns:
        the points in random order, so that every prefix is a fair sample.

    Raises:
        ValueError: for fewer than two plates or no points.
        UserError: where the plates have too little in common to measure depths.
    """
    if len(plates) < 2 or points < 1:
        raise ValueError(f"expected at least 2 plates and 1 point, got {len(plates)} and {points}")
    found = measured(plates, seed, workers, track)
    log(f"features: {found.features} triangulated, {found.sure} of them in three plates or more")
    if found.features < LEAST_FEATURES:
        raise _too_few(f"{LEAST_FEATURES} features", f"{found.features}")
    if found.share < LEAST_SHARE:
        raise _too_few(f"{LEAST_SHARE:.0%} of what they show", f"{found.share:.1%} ({found.cells} points)")
    surfaces = filled(found.surfaces, [small.grey() for small in found.smalls], seed) if fill else found.surfaces
    cloud, cells = coloured_points(plates, found.smalls, surfaces, points, seed)
    guessed = sum(int((surface.support[mine] == 0).sum()) for surface, mine in zip(surfaces, cells, strict=True))
    log(f"points: {len(cloud.xyz)}, {guessed} of them of what no two plates show alike, continued from around it")
    return cloud


def _too_few(least: str, got: str) -> UserError:
    return UserError(
        f"plates: expected at least {least} to be found in two of them alike, got {got}; walls without texture and "
        "cameras far apart cannot be triangulated: bring points of your own: --background FILE.ply"
    )
