"""Surfaces of several plates to points with colours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.background.plates import PlateView
from fourd.background.stereo.depth_maps import Small
from fourd.background.stereo.fusion import Surface
from fourd.background.stereo.thinning import Samples, thinned
from fourd.cameras import Camera
from fourd.ply import ColouredPoints

Array = NDArray[np.float64]


def coloured_points(
    plates: Sequence[PlateView], smalls: Sequence[Small], surfaces: Sequence[Surface], points: int, seed: int
) -> tuple[ColouredPoints, list[NDArray[np.intp]]]:
    """Points on the surfaces, about one for every equal area of the pictures.

    Args:
        plates: that give the colours.
        smalls: the plates as the surfaces have them.
        surfaces: one of each plate.
        points: wanted number, at least 1; fewer where the surfaces show less.
        seed: of their order.

    Returns:
        the points in random order, so that every prefix is a fair sample, and the cells of each surface, any of them
        more than once, that they lie in.
    """
    chosen = thinned(surfaces, [small.seen for small in smalls], points)
    found = _coloured(plates, surfaces, chosen)
    cells = [surface.depths.grid.cells_at(places.xy) for surface, places in zip(surfaces, chosen, strict=True)]
    order = np.random.default_rng(seed).permutation(len(found.xyz))
    return ColouredPoints(found.xyz[order], found.rgb[order]), cells


def _pixels(xy: Array, camera: Camera, plate: PlateView) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns (M,) of the plate's pixels at places (M, 2) of its smaller picture."""
    height, width = plate.seen.shape
    places = xy * (width / camera.width, height / camera.height)
    columns, rows = np.clip(places, 0, (width - 1, height - 1)).astype(np.intp).T
    return rows, columns


def _coloured(plates: Sequence[PlateView], surfaces: Sequence[Surface], chosen: Sequence[Samples]) -> ColouredPoints:
    """The chosen places as points, moved to the mean of the surfaces that agree on them, of the mean of their colours.

    What is near is measured more finely: weights are one by the depth's square.
    """
    xyz = np.concatenate([places.xyz for places in chosen])
    support = np.concatenate([places.support for places in chosen])
    origin = np.repeat(np.arange(len(plates)), [len(places.xyz) for places in chosen])
    rgb, nearness = np.zeros((len(xyz), 3)), np.zeros(len(xyz))
    for index, plate in enumerate(plates):
        mine = origin == index
        pixels, depth = plate.camera.project(xyz[mine])
        columns, rows = np.clip(pixels, 0, (plate.camera.width - 1, plate.camera.height - 1)).astype(np.intp).T
        rgb[mine], nearness[mine] = plate.rgb[rows, columns], 1 / depth
    weights = nearness[:, None] ** 2
    total = weights * np.hstack([xyz, rgb])
    for index, (plate, surface) in enumerate(zip(plates, surfaces, strict=True)):
        look = surface.look(xyz)
        rows, columns = _pixels(look.xy + 0.5, surface.camera, plate)
        measured = (look.cells >= 0) & (surface.support[look.cells] > 0) & (support > 0)
        agree = np.flatnonzero((origin != index) & measured & look.same & plate.seen[rows, columns])
        there = surface.world(look.xy[agree], look.inverse_depth[agree])
        weight = look.inverse_depth[agree, None] ** 2
        total[agree] += weight * np.hstack([there, plate.rgb[rows[agree], columns[agree]]])
        weights[agree] += weight
    mean = total / weights
    return ColouredPoints(mean[:, :3].astype(np.float32), np.rint(mean[:, 3:]).clip(0, 255).astype(np.uint8))
