"""Sample coloured points from the surfaces of several plates."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.formats.ply import ColouredPoints
from fourd.reconstruction.background.surfaces.surface_sampling import Samples, sample_surfaces
from fourd.recording.stereo.depth_maps import ReducedPlate
from fourd.recording.stereo.fusion import Surface
from fourd.recording.stereo.view import StereoView

Array = NDArray[np.float64]


def sample_coloured_points(
    plates: Sequence[StereoView], reduced: Sequence[ReducedPlate], surfaces: Sequence[Surface], points: int, seed: int
) -> tuple[ColouredPoints, list[NDArray[np.intp]]]:
    """Sample coloured points on surfaces such that they are evenly spread over the plates' images.

    Args:
        plates: full-size plates from which the colours are sampled.
        reduced: the same plates at the size used for stereo.
        surfaces: one surface per plate.
        points: requested number of points, at least 1. If the surfaces cover only few pixels of the plates, the result
            has fewer points than requested.
        seed: random seed of the points' order.

    Returns:
        the points in random order, and one array of cell indices per surface. For every N, the first N points are a
        uniform sample of all points. The array (M,) of a surface contains the depth-map cells of the M points that were
        sampled on it.
    """
    samples = sample_surfaces(surfaces, [plate.seen for plate in reduced], points)
    found = _fuse_colours(plates, surfaces, samples)
    cells = [surface.depths.grid.cells_at(each.xy) for surface, each in zip(surfaces, samples, strict=True)]
    order = np.random.default_rng(seed).permutation(len(found.xyz))
    return ColouredPoints(found.xyz[order], found.rgb[order]), cells


def _plate_pixels(xy: Array, camera: Camera, plate: StereoView) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Convert positions (M, 2) in the reduced plate to rows and columns (M,) of pixels in the full-size plate."""
    height, width = plate.seen.shape
    positions = xy * (width / camera.width, height / camera.height)
    columns, rows = np.clip(positions, 0, (width - 1, height - 1)).astype(np.intp).T
    return rows, columns


def _fuse_colours(
    plates: Sequence[StereoView], surfaces: Sequence[Surface], samples: Sequence[Samples]
) -> ColouredPoints:
    """Average the position and the colour of each sample over all surfaces that agree with its depth.

    A surface's weight is its inverse squared depth, because nearer surfaces are measured more precisely.
    """
    xyz = np.concatenate([each.xyz for each in samples])
    support = np.concatenate([each.support for each in samples])
    origin = np.repeat(np.arange(len(plates)), [len(each.xyz) for each in samples])
    rgb, inverse_depth = np.zeros((len(xyz), 3)), np.zeros(len(xyz))
    for index, plate in enumerate(plates):
        own = origin == index
        pixels, depth = plate.camera.project(xyz[own])
        columns, rows = np.clip(pixels, 0, (plate.camera.width - 1, plate.camera.height - 1)).astype(np.intp).T
        rgb[own], inverse_depth[own] = plate.rgb[rows, columns], 1 / depth
    weights = inverse_depth[:, None] ** 2
    total = weights * np.hstack([xyz, rgb])
    for index, (plate, surface) in enumerate(zip(plates, surfaces, strict=True)):
        projection = surface.project(xyz)
        rows, columns = _plate_pixels(projection.xy + 0.5, surface.camera, plate)
        measured = (projection.cells >= 0) & (surface.support[projection.cells] > 0) & (support > 0)
        agree = np.flatnonzero((origin != index) & measured & projection.on_surface & plate.seen[rows, columns])
        on_surface = surface.world(projection.xy[agree], projection.inverse_depth[agree])
        weight = projection.inverse_depth[agree, None] ** 2
        total[agree] += weight * np.hstack([on_surface, plate.rgb[rows[agree], columns[agree]]])
        weights[agree] += weight
    mean = total / weights
    return ColouredPoints(mean[:, :3].astype(np.float32), np.rint(mean[:, 3:]).clip(0, 255).astype(np.uint8))
