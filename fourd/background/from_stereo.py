"""Background points from clean plates by stereo: sparse features, consistent depth maps, even sampling."""

from __future__ import annotations

from collections.abc import Sequence

from fourd.background.plates import PlateView
from fourd.background.stereo.colouring import sample_coloured_points
from fourd.background.stereo.completion import complete_surfaces
from fourd.background.stereo.depth_maps import MIN_FEATURES, reconstruct_surfaces
from fourd.errors import UserError
from fourd.ply import ColouredPoints
from fourd.progress import Log, Track, untracked

MIN_SHARE = 0.1
"""Minimum share of the plates' visible cells with a measured depth."""


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
    """Create coloured points of a static background, about one per equal area of the pictures.

    Features of the plates are matched along epipolar lines and triangulated by COLMAP with fixed cameras. They and
    their dominant planes initialise a depth map of each plate (PatchMatch). Depths that other plates confirm and
    none contradicts are kept. The same input and seed give the same points.

    Args:
        plates: at least two.
        points: requested number, at least 1; fewer if the plates show less.
        fill: whether depths are extrapolated to areas that no two plates match.
        seed: random seed.
        workers: number of processes.
        log: reports the numbers of points found.
        track: progress callback.

    Returns:
        the points in random order: every prefix is a uniform sample.

    Raises:
        ValueError: for fewer than two plates or no points.
        UserError: if the plates overlap too little to measure depths.
    """
    if len(plates) < 2 or points < 1:
        raise ValueError(f"expected at least 2 plates and 1 point, got {len(plates)} and {points}")
    stereo = reconstruct_surfaces(plates, seed, workers, track)
    log(f"features: {stereo.feature_count} triangulated, {stereo.reliable_count} of them in three plates or more")
    if stereo.feature_count < MIN_FEATURES:
        raise _overlap_error(f"{MIN_FEATURES} features", f"{stereo.feature_count}")
    if stereo.measured_share < MIN_SHARE:
        raise _overlap_error(
            f"{MIN_SHARE:.0%} of their area", f"{stereo.measured_share:.1%} ({stereo.measured_cells} points)"
        )
    surfaces = stereo.surfaces
    if fill:
        surfaces = complete_surfaces(surfaces, [plate.grey_view() for plate in stereo.plates], seed)
    cloud, cells = sample_coloured_points(plates, stereo.plates, surfaces, points, seed)
    extrapolated = sum(int((surface.support[own] == 0).sum()) for surface, own in zip(surfaces, cells, strict=True))
    log(f"points: {len(cloud.xyz)}, of which {extrapolated} are extrapolated where no two plates match")
    return cloud


def _overlap_error(minimum: str, got: str) -> UserError:
    return UserError(
        f"plates: expected at least {minimum} to match between two of them, got {got}; walls without texture and "
        "cameras far apart cannot be triangulated: provide your own points: --background FILE.ply"
    )
