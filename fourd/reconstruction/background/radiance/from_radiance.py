"""Compute background points from clean plates (images of the empty scene) with a radiance field that is supervised by
stereo depths."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.formats.ply import ColouredPoints
from fourd.base.progress import Log, Track, untracked
from fourd.reconstruction.background.contraction import contraction_around
from fourd.reconstruction.background.plates import PlateView
from fourd.reconstruction.background.radiance.config import RadianceConfig
from fourd.reconstruction.background.radiance.depths import add_field_depths
from fourd.reconstruction.background.radiance.optimization import optimize_field
from fourd.reconstruction.background.radiance.pixels import Pixels
from fourd.reconstruction.background.radiance.rays import RayRange
from fourd.reconstruction.background.radiance.room_depth import Room
from fourd.reconstruction.background.surfaces.colouring import sample_coloured_points
from fourd.reconstruction.background.surfaces.completion import complete_surfaces
from fourd.reconstruction.background.surfaces.guidance import complete_with_guidance
from fourd.recording.capture.focus import viewing_centre
from fourd.recording.stereo.depth_maps import MIN_FEATURES, StereoResult
from fourd.recording.stereo.fusion import Surface
from fourd.recording.stereo.patches import GreyView

Array = NDArray[np.float64]

FEW_SHARE = 0.1
"""Threshold for two fractions of the depth-map cells outside the plates' holes (areas that do not show the background).
If the fraction of cells with a depth measured by stereo is below the threshold, a rough shape of the room guides the
extrapolation of depths. If the fraction of cells with a depth that two plates confirm is below the threshold, the log
calls the other depths a rough estimate."""
MIN_SHARE = 0.01
"""If the fraction of depth-map cells with a confirmed depth, among all cells outside the plates' holes, is below this
value, an error is raised."""


def seed_from_radiance(
    plates: Sequence[PlateView],
    stereo: StereoResult,
    points: int,
    config: RadianceConfig,
    *,
    near: float | None = None,
    seed: int = 0,
    log: Log = lambda line: None,
    track: Track = untracked,
) -> ColouredPoints:
    """Create coloured points of a static background. The points are evenly spread over the plates' images.

    Stereo measures depths where two plates match (:mod:`fourd.recording.stereo`); elsewhere, depths are extrapolated.
    A radiance field (Mueller et al. 2022) is then optimised on the plates' colours and on these depths. The depths are
    needed, because colours alone do not determine the geometry if the cameras are 20 degrees apart: the field would fit
    each plate with structures that only this plate's camera sees. In depth-map cells without stereo depth, the field's
    median depth is used if another plate confirms it. The same input, seed and number of torch threads give the same
    points.

    Args:
        plates: clean plates of at least two cameras.
        stereo: result of :func:`~fourd.recording.stereo.depth_maps.reconstruct_surfaces` on the plates.
        points: requested number of points, at least 1. If the plates have few visible pixels, the result has fewer
            points than requested.
        config: settings of the radiance field.
        near: depth in world units before which the cameras see no static surface, or None if unknown
            (:meth:`~fourd.reconstruction.background.radiance.rays.RayRange.from_near_plane`).
        seed: seed of the random numbers.
        log: reports the fraction of the plates' area with known depths, and how many points are measured, confirmed and
            extrapolated.
        track: progress callback.

    Returns:
        the points in random order. For every N, the first N points are a uniform sample of all points.

    Raises:
        ValueError: if there are fewer than two plates or ``points`` is less than 1.
        UserError: if too few depths are confirmed by two plates.
    """
    if len(plates) < 2 or points < 1:
        raise ValueError(f"expected at least 2 plates and 1 point, got {len(plates)} and {points}")
    log(f"stereo: {stereo.feature_count} features, depths measured for {stereo.measured_share:.0%} of the plates' area")
    if stereo.feature_count < MIN_FEATURES:
        raise _depth_error(f"{MIN_FEATURES} features to match between two plates", f"{stereo.feature_count}")
    if stereo.measured_share < FEW_SHARE:
        log("stereo: too few depths to supervise the field; the field's depths come mainly from colours")
    surfaces = _estimate_surfaces(stereo, config, near, seed, track)
    confirmed_cells = sum(int((surface.known & (surface.support > 0)).sum()) for surface in surfaces)
    confirmed = confirmed_cells / stereo.visible_cells
    if confirmed < MIN_SHARE:
        raise _depth_error(f"{MIN_SHARE:.0%} of their area to have depths that two plates confirm", f"{confirmed:.1%}")
    if confirmed < FEW_SHARE:
        log(
            f"background: two plates confirm the depths of {confirmed:.0%} of the plates' area; the rest is a rough "
            "estimate, with the largest errors between the cameras; add cameras or use --background FILE.ply"
        )
    cloud, cells = sample_coloured_points(plates, stereo.plates, surfaces, points, seed)
    log(_point_summary(stereo.surfaces, surfaces, cells))
    return cloud


def _estimate_surfaces(
    stereo: StereoResult, config: RadianceConfig, near: float | None, seed: int, track: Track
) -> list[Surface]:
    """Create one surface per plate. Each depth of a surface is measured, rendered from the field, or extrapolated."""
    cameras = [plate.camera for plate in stereo.plates]
    views = [plate.grey_view() for plate in stereo.plates]
    centre = viewing_centre(cameras)
    continued = _extrapolate(stereo, views, centre, seed)
    contraction = contraction_around(cameras, centre)
    unit = contraction.radius
    span = RayRange.from_near_plane(near, unit)
    pixels = Pixels.from_plates(stereo.plates, stereo.surfaces, continued, unit, span)
    field = optimize_field(pixels, contraction, config, seed, track)
    return add_field_depths(field, stereo.plates, stereo.surfaces, continued, track)


def _extrapolate(stereo: StereoResult, views: Sequence[GreyView], centre: Array, seed: int) -> list[Surface]:
    """Extrapolate depths into cells without a measured depth. If few cells are measured, a rough shape of the room
    guides the extrapolation."""
    room = Room.from_surfaces(stereo.surfaces, centre) if stereo.measured_share < FEW_SHARE else None
    if room is None:
        return complete_surfaces(stereo.surfaces, views, seed)
    guides = [room.surface_inverse_depths(surface) for surface in stereo.surfaces]
    return complete_with_guidance(stereo.surfaces, views, guides)


def _point_summary(measured: Sequence[Surface], surfaces: Sequence[Surface], cells: Sequence[NDArray[np.intp]]) -> str:
    """Describe how many points have measured, rendered and extrapolated depths."""
    total = sum(len(own) for own in cells)
    by_stereo = sum(int(surface.known[own].sum()) for surface, own in zip(measured, cells, strict=True))
    extrapolated = sum(int((surface.support[own] == 0).sum()) for surface, own in zip(surfaces, cells, strict=True))
    return (
        f"points: {total}, {by_stereo} measured by stereo, {total - by_stereo - extrapolated} from the field and "
        f"confirmed by two plates, {extrapolated} extrapolated where only one plate sees the surface"
    )


def _depth_error(minimum: str, got: str) -> UserError:
    return UserError(
        f"plates: expected at least {minimum}, got {got}; depths cannot be measured on walls without texture or if "
        "cameras are far apart; provide your own points with --background FILE.ply"
    )
