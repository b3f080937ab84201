"""The background's shell: points that fill the directions that no clean plate shows. Without the shell, rendered views
would be empty in these directions.

Directions are divided into cells. A known cell contains background points that were computed from the plates.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_edt, maximum_filter, maximum_filter1d

from fourd.base.cameras import Camera
from fourd.base.convex_hull import distance_to_hull
from fourd.base.formats.ply import ColouredPoints
from fourd.base.progress import Track, untracked
from fourd.reconstruction.background.height_profile import height_profile
from fourd.recording.capture.focus import median_distance
from fourd.recording.stereo.directions import (
    CELL_DEG,
    ROWS_PER_DEGREE,
    DirectionGrid,
    direction_grid,
    extrapolate_distances,
    interpolate_harmonic,
    summarize_cells,
)

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

COLOUR_WEIGHT = 16.0
"""Weight of horizontal neighbours in the extrapolation of colours, relative to the weight 1 of vertical neighbours. It
is large because floors, walls and skies vary less horizontally than vertically."""
SMALL_GAP_DEG = 1.5
"""Radius, in degrees, of the morphological closing of the known cells. The closing fills narrow gaps between known
cells, because such gaps are common between neighbouring points of a surface."""
RIM_FACTOR = 0.985
"""Factor that multiplies the inverse distances of the shell's rim, to place the rim slightly behind the known points.
The rim consists of shell points in those known cells that are next to unknown cells."""
NEAR_GAP_DEG = 15.0
"""Unknown cells at most this many degrees from the nearest known cell have the full density of shell points. Of the
cells farther away, only one in sixteen gets a point."""
MIN_DETAIL = 8.0
"""A shell point near known cells is split into four points if its cell or an adjacent cell contains detail. A cell
contains detail if the extrapolated colours of its upper and its lower half differ by at least this many grey levels.
Adjacent cells are included, because points are drawn as discs: the large disc of an adjacent point that is not split
would cover the four small discs."""
OCCLUSION_RATIO = 0.9
"""A shell point occludes a known point if both project to about the same position, and the shell point's depth is less
than this multiple of the known point's depth."""
DEPTH_CELL_PX = 6.0
WALL_FACTOR = 1.02
"""Minimum distance of the shell from the centre where cameras surround the scene, as a multiple of the distance to the
convex hull of the cameras."""
MIN_WALL_SHARE = 0.7
"""The convex hull of the cameras is taken for a wall in directions in which it is at least this far from the centre, as
a fraction of the median distance of the cameras. Above and below a ring of cameras, it is nearer."""


def build_shell(
    points: ColouredPoints,
    cameras: Sequence[Camera],
    centre: Array,
    track: Track = untracked,
    rig: Sequence[Camera] = (),
) -> ColouredPoints:
    """Build the shell: additional points that fill the directions without background points.

    Inverse distances and colours are interpolated harmonically between the known directions, with larger weights for
    horizontal than for vertical neighbours. The up direction is the cameras' mean up direction. Colours that depend
    only on the height, such as stripes of a wall, are extrapolated separately (:mod:`height_profile`). Points that
    would occlude known points in a camera are dropped.

    Args:
        points: background points that were computed from the plates.
        cameras: cameras of the plates.
        centre: (3,) world point at which the directions start.
        track: progress callback.
        rig: all cameras, of which only the positions are used. If empty, these are ``cameras``.
    """
    grid = direction_grid(cameras, centre)
    known = _known_cells(grid, points)
    if known.all() or not known.any():
        return ColouredPoints(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8))
    fine = direction_grid(cameras, centre, ROWS_PER_DEGREE)
    surface = track(_extrapolate(fine, points), 2, "background: unseen directions")
    directions, inverse, rgb, is_rim = _sample(grid, known, *surface)
    # The rim of the shell (shell points in known cells beside unknown cells) is placed slightly behind the known
    # points, so that no viewpoint shows a slit between the shell and the known points.
    inverse = np.where(is_rim, RIM_FACTOR, 1) * inverse
    # Cameras that surround the scene on all sides are in its walls, so the walls are not nearer.
    reach = median_distance(cameras, centre)
    walls = distance_to_hull(directions, np.array([camera.centre for camera in rig or cameras]), centre)
    is_wall = walls >= MIN_WALL_SHARE * reach
    inverse = np.where(is_wall, np.minimum(inverse, 1 / np.maximum(WALL_FACTOR * walls, 1e-9)), inverse)
    # Other shell points that are closer to the centre than the median camera are dropped. The cameras see this part of
    # the scene, so a gap in it only means that the known points are sparse there.
    is_sparse = ~is_wall & (inverse * reach >= 1)
    xyz = centre + directions / inverse[:, None]
    kept = ~is_sparse & ~occludes(xyz, points.xyz.astype(np.float64), cameras)
    colours = np.clip(np.rint(rgb[kept]), 0, 255).astype(np.uint8)
    return ColouredPoints(xyz[kept].astype(np.float32), colours)


def _known_cells(grid: DirectionGrid, points: ColouredPoints) -> Bools:
    """Return a (cells,) bool mask of the cells that contain points."""
    known = np.zeros(grid.rows * grid.columns, bool)
    known[grid.cells(points.xyz.astype(np.float64))[0]] = True
    return known


def _extrapolate(fine: DirectionGrid, points: ColouredPoints) -> Iterator[Array]:
    """Yield the inverse distances (cells,) and then the colours (cells, 3) of all cells of a fine grid."""
    cells, distance = fine.cells(points.xyz.astype(np.float64))
    known, inverse, rgb = summarize_cells(cells, distance, points.rgb, fine.rows * fine.columns)
    inverse = extrapolate_distances(fine, known, inverse)
    yield inverse
    profile = height_profile(fine, known, inverse, rgb)
    yield profile + interpolate_harmonic(fine, known, rgb - profile, COLOUR_WEIGHT)


def _sample(grid: DirectionGrid, known: Bools, inverse: Array, rgb: Array) -> tuple[Array, Array, Array, Bools]:
    """Sample the extrapolated surface at the shell's points.

    Args:
        grid: the coarse grid, with one point per selected cell.
        known: (cells,) bool, true for cells of the coarse grid with known points.
        inverse: inverse distances in the cells of the fine grid, which has ROWS_PER_DEGREE rows per degree.
        rgb: colours in the cells of the fine grid.

    Returns:
        the points' directions (N, 3), inverse distances (N,), colours (N, 3), and whether the points are in known cells
        (N,).
    """
    cells, step, is_near = _select_cells(grid, known)
    row, column = cells // grid.columns, cells % grid.columns
    values = np.column_stack([inverse, rgb]).reshape(grid.rows, 2, ROWS_PER_DEGREE // 2, grid.columns, 4).mean(axis=2)
    lower, upper = values[row, 0, column], values[row, 1, column]
    contrast = np.abs(values[:, 1, :, 1:] - values[:, 0, :, 1:]).max(axis=-1)
    contrast = maximum_filter(contrast, 3, mode=("nearest", "wrap"))
    split = is_near & (contrast[row, column] >= MIN_DETAIL)
    rows, columns = grid.places(cells)
    places = [(rows[~split], columns[~split], (lower + upper)[~split] / 2, cells[~split])]
    for vertical, half in ((-0.25, lower), (0.25, upper)):
        for side in (-0.25, 0.25):
            across = columns + side * step
            places.append((rows[split] + vertical, across[split], half[split], cells[split]))
    rows, columns, sampled, cell = (np.concatenate(parts) for parts in zip(*places, strict=True))
    return grid.directions_at(rows, columns), sampled[:, 0], sampled[:, 1:], known[cell]


def direction_coverage(points: ColouredPoints, centre: Array, cameras: Sequence[Camera]) -> float:
    """Compute the fraction, in [0, 1], of all directions around ``centre`` that contain points. Small gaps count as
    covered."""
    sphere = direction_grid(cameras, centre)
    closed, _ = _close_gaps(sphere, _known_cells(sphere, points))
    elevation = ((np.arange(sphere.rows) + 0.5) / sphere.rows - 0.5) * np.pi
    weight = np.cos(elevation)[:, None]
    return float((closed * weight).sum() / (sphere.columns * weight.sum()))


def _select_cells(sphere: DirectionGrid, known: Bools) -> tuple[NDArray[np.intp], NDArray[np.intp], Bools]:
    """Select the cells that get a shell point: unknown cells and a rim of known cells.

    Near known cells, the density of the selected cells is uniform over the sphere. Far from known cells, it is lower.

    Returns:
        flat indices (N,) of the selected cells; for each of them, the spacing (N,), in columns, of the selected cells
        around it in its row, which is larger near the poles and far from known cells; and a bool mask (N,), true for
        selected cells near known cells.
    """
    grid, degrees = _close_gaps(sphere, known)
    wider = np.pad(grid, ((1, 1), (1, 1)), mode="wrap")
    wider[[0, -1]] = True
    rim = (wider & binary_dilation(~wider, np.ones((3, 3), np.bool_)))[1:-1, 1:-1]
    row, column = np.indices(grid.shape)
    elevation = ((row + 0.5) / sphere.rows - 0.5) * np.pi
    step = np.maximum(1, np.rint(1 / np.maximum(np.cos(elevation), 1e-3))).astype(np.intp)
    step = np.where(degrees > NEAR_GAP_DEG, 4 * step, step)
    level = np.where(degrees > NEAR_GAP_DEG, row % 4 == 0, True)
    # Far from known cells, every second row with points is offset by half the distance between its points, because the
    # resulting hexagonal layout covers the sphere most evenly.
    offset = np.where(degrees > NEAR_GAP_DEG, row // 4 % 2 * (step // 2), 0)
    cells = np.flatnonzero(((~grid | rim) & ((column + offset) % step == 0) & level).ravel())
    return cells, step.ravel()[cells], degrees.ravel()[cells] <= NEAR_GAP_DEG


def _close_gaps(sphere: DirectionGrid, known: Bools) -> tuple[Bools, Array]:
    """Close small gaps between known cells. Returns a mask (rows, columns) of the known cells and the closed gaps, and
    the angle in degrees (rows, columns) from each cell to the nearest known cell. For the angle, closed gaps count as
    unknown."""
    known = _dilate_rows(sphere, known)
    # Three copies of the grid side by side make the distance transform periodic in azimuth.
    tiled = np.pad(np.tile(known, (1, 3)), ((sphere.rows, sphere.rows), (0, 0)))
    middle = (slice(sphere.rows, 2 * sphere.rows), slice(sphere.columns, 2 * sphere.columns))
    degrees = distance_transform_edt(~tiled) * CELL_DEG
    closed = tiled | (distance_transform_edt(degrees <= SMALL_GAP_DEG) * CELL_DEG > SMALL_GAP_DEG)
    return closed[middle], degrees[middle]


def _dilate_rows(sphere: DirectionGrid, known: Bools) -> Bools:
    """Dilate the known cells (rows, columns) along the rows by one degree on the sphere, which spans more cells near
    the poles than at the equator."""
    wide = known.reshape(sphere.rows, sphere.columns).copy()
    for row in range(sphere.rows):
        elevation = ((row + 0.5) / sphere.rows - 0.5) * np.pi
        reach = int(1 / np.cos(elevation))
        if reach > 1:
            wide[row] = maximum_filter1d(wide[row], min(2 * reach + 1, sphere.columns), mode="wrap")
    return wide


def occludes(xyz: Array, seen: Array, cameras: Sequence[Camera]) -> Bools:
    """Return a mask (N,) of the points ``xyz`` that occlude at least one of the known points ``seen`` (M, 3) in at
    least one camera."""
    hides = np.zeros(len(xyz), np.bool_)
    for camera in cameras:
        columns = int(camera.width / DEPTH_CELL_PX) + 1
        depths = np.full((int(camera.height / DEPTH_CELL_PX) + 1) * columns, np.inf)
        cell, depth = _depth_cells(seen, camera, columns)
        np.minimum.at(depths, cell[cell >= 0], depth[cell >= 0])
        cell, depth = _depth_cells(xyz, camera, columns)
        there = cell >= 0
        nearest = depths[cell[there]]
        hides[there] |= np.isfinite(nearest) & (depth[there] < OCCLUSION_RATIO * nearest)
    return hides


def _depth_cells(xyz: Array, camera: Camera, columns: int) -> tuple[NDArray[np.intp], Array]:
    """Compute the index (N,) of each point's cell in a coarse depth map with ``columns`` columns, or -1 outside the
    image, and the point's depth (N,)."""
    pixels, depth = camera.project(xyz)
    inside = (depth > 1e-6) & (pixels >= 0).all(axis=1) & (pixels < (camera.width, camera.height)).all(axis=1)
    place = np.where(inside[:, None], pixels / DEPTH_CELL_PX, 0).astype(np.intp)
    return np.where(inside, place[:, 1] * columns + place[:, 0], -1), depth
