"""Compute background points from clean plates (images of the empty scene) by stereo.

The plates' depth maps are initialised from triangulated sparse features and refined. Depths that disagree between
plates are removed. Points are then sampled on the surfaces that the remaining depths describe.
"""

from __future__ import annotations

from collections.abc import Sequence

from fourd.base.errors import UserError
from fourd.base.formats.ply import ColouredPoints
from fourd.base.progress import Log
from fourd.reconstruction.background.plates import PlateView
from fourd.reconstruction.background.surfaces.colouring import sample_coloured_points
from fourd.reconstruction.background.surfaces.completion import complete_surfaces
from fourd.recording.stereo.depth_maps import MIN_FEATURES, StereoResult

MIN_SHARE = 0.1
"""Minimum fraction of depth-map cells with a measured depth, among all cells outside the plates' holes (areas that do
not show the background). If the fraction is smaller, an error is raised."""


def seed_from_stereo(
    plates: Sequence[PlateView],
    stereo: StereoResult,
    points: int,
    *,
    fill: bool = True,
    seed: int = 0,
    log: Log = lambda line: None,
) -> ColouredPoints:
    """Create coloured points of a static background. The points are evenly spread over the plates' images.

    COLMAP matches features of the plates along epipolar lines and triangulates them with fixed cameras. The depth map
    of each plate is initialised from the triangulated features and from dominant planes that are fitted to these
    features. PatchMatch optimises the initialised depth map. A depth is kept if more plates confirm it than contradict
    it. The same input and seed give the same points.

    Args:
        plates: clean plates of at least two cameras.
        stereo: result of :func:`~fourd.recording.stereo.depth_maps.reconstruct_surfaces` on the plates.
        points: requested number of points, at least 1. If the plates show the background at few pixels, the result has
            fewer points than requested.
        fill: whether to extrapolate depth into areas where stereo finds no match.
        seed: seed of the random numbers.
        log: reports the number of features and the number of points.

    Returns:
        the points in random order. For every N, the first N points are a uniform sample of all points.

    Raises:
        ValueError: if there are fewer than two plates or ``points`` is less than 1.
        UserError: if the plates overlap too little to measure depths.
    """
    if len(plates) < 2 or points < 1:
        raise ValueError(f"expected at least 2 plates and 1 point, got {len(plates)} and {points}")
    log(f"features: {stereo.feature_count} triangulated, {stereo.reliable_count} of them seen in three plates or more")
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
        f"plates: expected at least {minimum} to match between two plates, got {got}; depths cannot be triangulated on "
        "walls without texture or if cameras are far apart; provide your own points with --background FILE.ply"
    )
