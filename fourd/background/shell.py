"""What no plate shows: a shell that continues the background around its gaps, so that no view ends in nothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt, maximum_filter1d

from fourd.background.directions import CELL_DEG, Sphere, far_side, harmonic, sphere_about
from fourd.cameras import Camera
from fourd.ply import ColouredPoints

Array = NDArray[np.float64]

ACROSS = 6.0
"""How much more alike rooms are along the horizon than up and down: floors, walls and skies are level."""
SMALL_GAP_DEG = 1.5
"""Of a gap that is none: points lie apart."""
BEHIND = 0.985
"""Of the inverse distance of what is known, for the shell's rim."""
NEAR_GAP_DEG = 15.0
"""Farther than this from all that is known, one cell in sixteen gets a point."""
HIDING = 0.9
"""Of the depth of what a camera sees; a guess that is nearer would hide it."""
DEPTH_CELL_PX = 6.0


def build_shell(points: ColouredPoints, cameras: Sequence[Camera], centre: Array) -> ColouredPoints:
    """Points in the directions in which there are none, at distances and of colours continued from around them.

    Inverse distance and colour are harmonic between the known directions, more so along the horizon, which is that of
    the cameras' mean upright. What would hide from a camera what it sees is left out.

    Args:
        points: what the plates show.
        cameras: that look at the scene.
        centre: (3,) world point that directions are taken from.
    """
    sphere = sphere_about(cameras, centre)
    cells, distance = sphere.cells(points.xyz.astype(np.float64))
    known, inverse, rgb = far_side(cells, distance, points.rgb, sphere.rows * sphere.columns)
    if known.all() or not known.any():
        return ColouredPoints(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8))
    filled = harmonic(sphere, known, np.column_stack([inverse, rgb]), ACROSS)
    chosen = _chosen(sphere, known)
    # A rim lies behind what is known: seen from elsewhere than the middle, no slit opens between it and the shell.
    filled[known, 0] *= BEHIND
    xyz = sphere.centre + sphere.directions()[chosen] / filled[chosen, :1]
    colours = np.clip(np.rint(filled[chosen, 1:]), 0, 255).astype(np.uint8)
    # What is nearer than the cameras stands between them and is seen by some; there points merely lie widely apart.
    reach = float(np.median([np.linalg.norm(camera.centre - centre) for camera in cameras]))
    kept = (filled[chosen, 0] * reach < 1) & ~_hiding(xyz, points.xyz.astype(np.float64), cameras)
    return ColouredPoints(xyz[kept].astype(np.float32), colours[kept])


def direction_coverage(points: ColouredPoints, centre: Array, cameras: Sequence[Camera]) -> float:
    """Share of all directions about ``centre`` in which there are points, gaps between these not counted."""
    sphere = sphere_about(cameras, centre)
    cells, _ = sphere.cells(points.xyz.astype(np.float64))
    known = np.zeros(sphere.rows * sphere.columns, bool)
    known[cells] = True
    closed, _ = _closed(sphere, known)
    elevation = ((np.arange(sphere.rows) + 0.5) / sphere.rows - 0.5) * np.pi
    weight = np.cos(elevation)[:, None]
    return float((closed * weight).sum() / (sphere.columns * weight.sum()))


def viewing_centre(cameras: Sequence[Camera]) -> Array:
    """(3,) world point nearest to the cameras' optical axes; the cameras' mean where these are all parallel."""
    centres = np.stack([camera.centre for camera in cameras])
    across = np.stack([np.eye(3) - np.outer(camera.forward, camera.forward) for camera in cameras])
    normal = across.sum(axis=0)
    if np.linalg.cond(normal) > 1e8:
        return np.asarray(centres.mean(axis=0))
    return np.asarray(np.linalg.solve(normal, np.einsum("nij,nj->i", across, centres)))


def _chosen(sphere: Sphere, known: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Unknown cells to put a point in, and a rim of known ones: as many as the sphere's area asks for, and few far
    from all that is known."""
    grid, away = _closed(sphere, known)
    wider = np.pad(grid, ((1, 1), (1, 1)), mode="wrap")
    wider[[0, -1]] = True
    rim = (wider & binary_dilation(~wider, np.ones((3, 3))))[1:-1, 1:-1]
    row, column = np.indices(grid.shape)
    elevation = ((row + 0.5) / sphere.rows - 0.5) * np.pi
    step = np.maximum(1, np.rint(1 / np.maximum(np.cos(elevation), 1e-3))).astype(np.intp)
    step = np.where(away > NEAR_GAP_DEG, 4 * step, step)
    level = np.where(away > NEAR_GAP_DEG, row % 4 == 0, True)
    # Every other of the few rows is moved by half a step: so points cover best.
    moved = np.where(away > NEAR_GAP_DEG, row // 4 % 2 * (step // 2), 0)
    return np.flatnonzero(((~grid | rim) & ((column + moved) % step == 0) & level).ravel())


def _closed(sphere: Sphere, known: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], Array]:
    """(rows, columns) what is known, without small gaps; and how far from it each cell is, in degrees."""
    known = _widened(sphere, known)
    # Three turns side by side: what is done to neighbours runs on over the seam.
    turns = np.pad(np.tile(known, (1, 3)), ((sphere.rows, sphere.rows), (0, 0)))
    middle = (slice(sphere.rows, 2 * sphere.rows), slice(sphere.columns, 2 * sphere.columns))
    away = distance_transform_edt(~turns) * CELL_DEG
    closed = turns | (distance_transform_edt(away <= SMALL_GAP_DEG) * CELL_DEG > SMALL_GAP_DEG)
    return closed[middle], away[middle]


def _widened(sphere: Sphere, known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(rows, columns) cells with a known one so near as two cells are on the horizon: towards the poles they narrow."""
    wide = known.reshape(sphere.rows, sphere.columns).copy()
    for row in range(sphere.rows):
        elevation = ((row + 0.5) / sphere.rows - 0.5) * np.pi
        reach = int(1 / np.cos(elevation))
        if reach > 1:
            wide[row] = maximum_filter1d(wide[row], min(2 * reach + 1, sphere.columns), mode="wrap")
    return wide


def _hiding(xyz: Array, seen: Array, cameras: Sequence[Camera]) -> NDArray[np.bool_]:
    """Which of points (N, 3) lie before what some camera sees of the points ``seen`` (M, 3)."""
    hides = np.zeros(len(xyz), np.bool_)
    for camera in cameras:
        columns = int(camera.width / DEPTH_CELL_PX) + 1
        depths = np.full((int(camera.height / DEPTH_CELL_PX) + 1) * columns, np.inf)
        cell, depth = _depth_cells(seen, camera, columns)
        np.minimum.at(depths, cell[cell >= 0], depth[cell >= 0])
        cell, depth = _depth_cells(xyz, camera, columns)
        there = cell >= 0
        nearest = depths[cell[there]]
        hides[there] |= np.isfinite(nearest) & (depth[there] < HIDING * nearest)
    return hides


def _depth_cells(xyz: Array, camera: Camera, columns: int) -> tuple[NDArray[np.intp], Array]:
    """Cells (N,) of a coarse depth map that points fall into, -1 outside the picture, and their depths (N,)."""
    pixels, depth = camera.project(xyz)
    inside = (depth > 1e-6) & (pixels >= 0).all(axis=1) & (pixels < (camera.width, camera.height)).all(axis=1)
    place = np.where(inside[:, None], pixels / DEPTH_CELL_PX, 0).astype(np.intp)
    return np.where(inside, place[:, 1] * columns + place[:, 0], -1), depth
