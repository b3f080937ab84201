"""Background points from clean plates by a radiance field, which stereo tells where surfaces are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.background.contraction import contraction_around
from fourd.background.plates import PlateView
from fourd.background.radiance.config import RadianceConfig
from fourd.background.radiance.depths import field_depths
from fourd.background.radiance.fitting import fit_field
from fourd.background.radiance.pixels import Pixels
from fourd.background.radiance.room_depth import Room
from fourd.background.shell import viewing_centre
from fourd.background.stereo.colouring import coloured_points
from fourd.background.stereo.completion import filled
from fourd.background.stereo.depth_maps import LEAST_FEATURES, Measured, measured
from fourd.background.stereo.fusion import Surface
from fourd.background.stereo.guidance import guided
from fourd.background.stereo.patches import GreyView
from fourd.errors import UserError
from fourd.ply import ColouredPoints
from fourd.progress import Log, Track, untracked

Array = NDArray[np.float64]

FEW_SHARE = 0.1
LEAST_SHARE = 0.01
"""Of the plates' cells: at depths that two plates agree on. With few the rest is guesswork; with less there is none."""


def seed_from_radiance(
    plates: Sequence[PlateView],
    points: int,
    config: RadianceConfig,
    *,
    seed: int = 0,
    workers: int = 1,
    log: Log = lambda line: None,
    track: Track = untracked,
) -> ColouredPoints:
    """Points of a still background, about one for every equal area of the pictures, with colours.

    Stereo measures what two plates show alike (:mod:`fourd.background.stereo`); what a single plate shows is continued
    from that. A field (Mueller et al. 2022) is fitted to the plates' colours and to these depths:
    pictures alone, 20 degrees apart, are each explained best by what only its own camera sees. Its median depth
    counts where stereo measured nothing. The same input, seed and number of torch's threads give the same points.

    Args:
        plates: at least two.
        points: wanted number, at least 1; fewer where the plates show less.
        config: the field's.
        seed: of all that is random.
        workers: processes that measure.
        say: told what was found and how much of it is a guess, a line each.
        track: for progress.

    Returns:
        the points in random order, so that every prefix is a fair sample.

    Raises:
        ValueError: for fewer than two plates or no points.
        UserError: where too few depths are found that two plates agree on.
    """
    if len(plates) < 2 or points < 1:
        raise ValueError(f"expected at least 2 plates and 1 point, got {len(plates)} and {points}")
    stereo = measured(plates, seed, workers, track)
    log(f"stereo: {stereo.features} features, {stereo.share:.0%} of what the plates show is measured")
    if stereo.features < LEAST_FEATURES:
        raise _too_little(f"{LEAST_FEATURES} features to be found in two of them alike", f"{stereo.features}")
    if stereo.share < FEW_SHARE:
        log("stereo: that is too little to tell the field where surfaces are; colours have to")
    surfaces = _surfaces(stereo, config, seed, track)
    agreed = sum(int((surface.known & (surface.support > 0)).sum()) for surface in surfaces) / stereo.shown
    if agreed < LEAST_SHARE:
        raise _too_little(
            f"{LEAST_SHARE:.0%} of what they show to have depths that two of them agree on", f"{agreed:.1%}"
        )
    if agreed < FEW_SHARE:
        log(
            f"background: of what the plates show {agreed:.0%} has depths that two agree on; the rest is a rough "
            "guess, worst from between the cameras; more cameras or --background FILE.ply would help"
        )
    cloud, cells = coloured_points(plates, stereo.smalls, surfaces, points, seed)
    log(_told(stereo.surfaces, surfaces, cells))
    return cloud


def _surfaces(stereo: Measured, config: RadianceConfig, seed: int, track: Track) -> list[Surface]:
    """A surface of each plate, with all depths that were measured, that the field found, or that are guesses."""
    cameras = [small.camera for small in stereo.smalls]
    views = [small.grey() for small in stereo.smalls]
    centre = viewing_centre(cameras)
    continued = _continued(stereo, views, centre, seed)
    contraction = contraction_around(cameras, centre)
    pixels = Pixels.of(stereo.smalls, stereo.surfaces, continued, contraction.radius)
    field = fit_field(pixels, contraction, config, seed, track)
    return field_depths(field, stereo.smalls, stereo.surfaces, continued, track)


def _continued(stereo: Measured, views: Sequence[GreyView], centre: Array, seed: int) -> list[Surface]:
    """The surfaces with guesses where nothing is measured, from what is measured around, or of the room as a whole."""
    room = Room.around(stereo.surfaces, centre) if stereo.share < FEW_SHARE else None
    if room is None:
        return filled(stereo.surfaces, views, seed)
    return guided(stereo.surfaces, views, [room.seen_by(surface) for surface in stereo.surfaces])


def _told(measured: Sequence[Surface], surfaces: Sequence[Surface], cells: Sequence[NDArray[np.intp]]) -> str:
    """How many points there are, by how they are known."""
    total = sum(len(mine) for mine in cells)
    sure = sum(int(surface.known[mine].sum()) for surface, mine in zip(measured, cells, strict=True))
    guessed = sum(int((surface.support[mine] == 0).sum()) for surface, mine in zip(surfaces, cells, strict=True))
    return (
        f"points: {total}, {sure} of them measured by stereo, {total - sure - guessed} where the field has two plates "
        f"agree, {guessed} guesses of what one plate alone shows"
    )


def _too_little(least: str, got: str) -> UserError:
    return UserError(
        f"plates: expected at least {least}, got {got}; walls without texture and cameras far apart tell no depths: "
        "bring points of your own: --background FILE.ply"
    )
