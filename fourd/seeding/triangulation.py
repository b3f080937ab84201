"""Background points from clean plates: features triangulated, then depth maps that agree, thinned evenly."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera
from fourd.errors import UserError
from fourd.progress import Track, untold
from fourd.seeding.plates import PlateView
from fourd.seeding.ply import CarvedPoints
from fourd.seeding.stereo.depth import DepthMap, depth_map
from fourd.seeding.stereo.filling import filled
from fourd.seeding.stereo.fusing import Surface, agreed
from fourd.seeding.stereo.guesses import as_seen, large_planes, triangles
from fourd.seeding.stereo.patches import Floats, GreyView, Grid
from fourd.seeding.stereo.sources import best_sources
from fourd.seeding.stereo.sparse import SparsePoints, sparse_points
from fourd.seeding.stereo.thinning import Samples, thinned
from fourd.spreading import spread

Array = NDArray[np.float64]
Say = Callable[[str], None]

LONGEST_SIDE = 640
"""Pixels; pictures are compared at this size."""
CELLS = 16384
"""Of a depth map, at most."""
LEAST_FEATURES = 8
"""Triangulated, to know at which depths to look."""
LEAST_SURE = 30
LEAST_SHARE = 0.1
"""Of the plates' cells, measured."""
NEARER, FARTHER = 0.5, 4.0
"""Of the nearest and the farthest triangulated points: where surfaces may be."""


def triangulated(
    plates: Sequence[PlateView],
    points: int,
    *,
    fill: bool = True,
    seed: int = 0,
    workers: int = 1,
    say: Say = lambda line: None,
    track: Track = untold,
) -> CarvedPoints:
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
    features = sparse_points(plates, seed, track)
    say(f"features: {len(features.xyz)} triangulated, {int(features.sure.sum())} of them in three plates or more")
    if len(features.xyz) < LEAST_FEATURES:
        raise _too_few(f"{LEAST_FEATURES} features", f"{len(features.xyz)}")
    smalls = [_Small.of(plate) for plate in plates]
    surfaces = agreed([small.camera for small in smalls], _maps(smalls, features, seed, workers, track))
    measured = sum(int(surface.known.sum()) for surface in surfaces)
    share = measured / max(1, sum(int(small.seen[small.grid().indices].sum()) for small in smalls))
    if share < LEAST_SHARE:
        raise _too_few(f"{LEAST_SHARE:.0%} of what they show", f"{share:.1%} ({measured} points)")
    if fill:
        surfaces = filled(surfaces, [small.grey() for small in smalls], seed)
    chosen = thinned(surfaces, [small.seen for small in smalls], points)
    found = _coloured(plates, surfaces, chosen)
    guessed = sum(int((places.support == 0).sum()) for places in chosen)
    say(f"points: {len(found.xyz)}, {guessed} of them of what no two plates show alike, continued from around it")
    order = np.random.default_rng(seed).permutation(len(found.xyz))
    return CarvedPoints(found.xyz[order], found.rgb[order])


def _too_few(least: str, got: str) -> UserError:
    return UserError(
        f"plates: expected at least {least} to be found in two of them alike, got {got}; walls without texture and "
        "cameras far apart cannot be triangulated: bring points of your own: --background FILE.ply"
    )


@dataclass(frozen=True, eq=False)
class _Small:
    """A plate at the size at which pictures are compared."""

    camera: Camera
    rgb: NDArray[np.uint8]
    seen: NDArray[np.bool_]

    @staticmethod
    def of(plate: PlateView) -> _Small:
        scale = min(1.0, LONGEST_SIDE / max(plate.camera.width, plate.camera.height))
        camera = plate.camera.scaled(scale)
        size = (camera.width, camera.height)
        rgb = cv2.resize(plate.rgb, size, interpolation=cv2.INTER_AREA)
        share = cv2.resize(plate.seen.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        return _Small(camera, np.asarray(rgb, np.uint8), share > 0.999)

    def grey(self) -> GreyView:
        return GreyView.of(self.camera, self.rgb, self.seen)

    def grid(self) -> Grid:
        stride = int(np.ceil(np.sqrt(self.camera.width * self.camera.height / CELLS)))
        return Grid.over(self.camera.width, self.camera.height, stride)


@dataclass(frozen=True, eq=False)
class _Job:
    """One depth map for a process."""

    index: int
    plate: _Small
    sources: tuple[_Small, ...]
    features: Array
    planes: Array
    nearest: float
    farthest: float
    seed: int


def _maps(smalls: Sequence[_Small], features: SparsePoints, seed: int, workers: int, track: Track) -> list[DepthMap]:
    """A depth map of each plate."""
    cameras = [small.camera for small in smalls]
    kept = features.sure if features.sure.sum() >= LEAST_SURE else np.ones(len(features.xyz), bool)
    distances = np.concatenate([np.linalg.norm(features.xyz[kept] - camera.centre, axis=1) for camera in cameras])
    rng = np.random.default_rng(seed)
    planes = large_planes(features.xyz, features.seen.sum(axis=1) - 1.0, float(np.median(distances)), rng)
    ranges = _ranges(cameras, features.xyz[kept])
    jobs = []
    for index, (nearest, farthest) in enumerate(ranges):
        sources = tuple(smalls[other] for other in best_sources(cameras, index, nearest, farthest))
        mine = features.xyz[features.seen[:, index]]
        jobs.append(_Job(index, smalls[index], sources, mine, planes, nearest, farthest, seed))
    maps = dict(track(spread(_map, jobs, workers), len(jobs), "depth maps"))
    return [maps[index] for index in range(len(smalls))]


def _ranges(cameras: Sequence[Camera], xyz: Array) -> list[tuple[float, float]]:
    """Depths between which to look, by camera: about those of the points in its picture, or else in all."""
    depths = []
    for camera in cameras:
        pixels, depth = camera.project(xyz)
        inside = (depth > 0) & (pixels >= 0).all(axis=1) & (pixels <= (camera.width, camera.height)).all(axis=1)
        depths.append(depth[inside])
    everything = np.concatenate(depths)
    ends = [np.percentile(mine if len(mine) >= LEAST_FEATURES else everything, (1, 99)) for mine in depths]
    return [(NEARER * float(low), FARTHER * float(high)) for low, high in ends]


def _map(job: _Job) -> Iterator[tuple[int, DepthMap]]:
    """Work of one process: the map of one plate, with its number."""
    grid, camera = job.plate.grid(), job.plate.camera
    guesses: list[Floats] = [as_seen(plane, camera, grid) for plane in job.planes]
    guesses += triangles(job.features, camera, grid)
    sources = [source.grey() for source in job.sources]
    yield (
        job.index,
        depth_map(job.plate.grey(), sources, grid, guesses, job.nearest, job.farthest, job.seed + job.index),
    )


def _pixels(xy: Array, camera: Camera, plate: PlateView) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns (M,) of the plate's pixels at places (M, 2) of its smaller picture."""
    height, width = plate.seen.shape
    places = xy * (width / camera.width, height / camera.height)
    columns, rows = np.clip(places, 0, (width - 1, height - 1)).astype(np.intp).T
    return rows, columns


def _coloured(plates: Sequence[PlateView], surfaces: Sequence[Surface], chosen: Sequence[Samples]) -> CarvedPoints:
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
    return CarvedPoints(mean[:, :3].astype(np.float32), np.rint(mean[:, 3:]).clip(0, 255).astype(np.uint8))
