"""What clean plates show alike: depth maps of all plates, of which remains what others confirm."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.background.plates import PlateView
from fourd.background.stereo.fusion import Surface, agreed
from fourd.background.stereo.patches import Floats, GreyView, Grid
from fourd.background.stereo.patchmatch import DepthMap, depth_map
from fourd.background.stereo.plane_hypotheses import as_seen, large_planes, triangles
from fourd.background.stereo.source_selection import best_sources
from fourd.background.stereo.sparse import SparsePoints, triangulate_sparse
from fourd.cameras import Camera
from fourd.parallel import run_jobs
from fourd.progress import Track

Array = NDArray[np.float64]

LONGEST_SIDE = 640
"""Pixels; pictures are compared at this size."""
CELLS = 16384
"""Of a depth map, at most."""
LEAST_FEATURES = 8
"""Triangulated, to know at which depths to look."""
LEAST_SURE = 30
NEARER, FARTHER = 0.5, 4.0
"""Of the nearest and the farthest triangulated points: where surfaces may be."""


@dataclass(frozen=True, eq=False)
class Measured:
    """What stereo finds in plates.

    Attributes:
        features: triangulated.
        sure: of them, in three plates or more.
        smalls: the plates as they were compared.
        surfaces: one of each plate; nothing is known of them where there are fewer features than 8.
    """

    features: int
    sure: int
    smalls: list[Small]
    surfaces: list[Surface]

    @property
    def cells(self) -> int:
        """Cells whose depth is measured."""
        return sum(int(surface.known.sum()) for surface in self.surfaces)

    @property
    def shown(self) -> int:
        """Cells in which the plates show something, at least 1."""
        return max(1, sum(int(small.seen[small.grid().indices].sum()) for small in self.smalls))

    @property
    def share(self) -> float:
        """Cells whose depth is measured, of those shown."""
        return self.cells / self.shown


def measured(plates: Sequence[PlateView], seed: int, workers: int, track: Track) -> Measured:
    """Triangulate features, and find of each plate's depth map what other plates confirm and none contradicts."""
    features = triangulate_sparse(plates, seed, track)
    smalls = [Small.of(plate) for plate in plates]
    cameras = [small.camera for small in smalls]
    if len(features.xyz) < LEAST_FEATURES:
        maps = [DepthMap.unknown(small.grid()) for small in smalls]
    else:
        maps = _maps(smalls, features, seed, workers, track)
    return Measured(len(features.xyz), int(features.reliable.sum()), smalls, agreed(cameras, maps))


@dataclass(frozen=True, eq=False)
class Small:
    """A plate at the size at which pictures are compared."""

    camera: Camera
    rgb: NDArray[np.uint8]
    seen: NDArray[np.bool_]

    @staticmethod
    def of(plate: PlateView) -> Small:
        scale = min(1.0, LONGEST_SIDE / max(plate.camera.width, plate.camera.height))
        camera = plate.camera.rescale(scale)
        size = (camera.width, camera.height)
        rgb = cv2.resize(plate.rgb, size, interpolation=cv2.INTER_AREA)
        share = cv2.resize(plate.seen.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        return Small(camera, np.asarray(rgb, np.uint8), share > 0.999)

    def grey(self) -> GreyView:
        return GreyView.of(self.camera, self.rgb, self.seen)

    def grid(self) -> Grid:
        stride = int(np.ceil(np.sqrt(self.camera.width * self.camera.height / CELLS)))
        return Grid.over(self.camera.width, self.camera.height, stride)


@dataclass(frozen=True, eq=False)
class _Job:
    """One depth map for a process."""

    index: int
    plate: Small
    sources: tuple[Small, ...]
    features: Array
    planes: Array
    nearest: float
    farthest: float
    seed: int


def _maps(smalls: Sequence[Small], features: SparsePoints, seed: int, workers: int, track: Track) -> list[DepthMap]:
    """A depth map of each plate."""
    cameras = [small.camera for small in smalls]
    kept = features.reliable if features.reliable.sum() >= LEAST_SURE else np.ones(len(features.xyz), bool)
    distances = np.concatenate([np.linalg.norm(features.xyz[kept] - camera.centre, axis=1) for camera in cameras])
    rng = np.random.default_rng(seed)
    planes = large_planes(features.xyz, features.seen.sum(axis=1) - 1.0, float(np.median(distances)), rng)
    ranges = _ranges(cameras, features.xyz[kept])
    jobs = []
    for index, (nearest, farthest) in enumerate(ranges):
        sources = tuple(smalls[other] for other in best_sources(cameras, index, nearest, farthest))
        mine = features.xyz[features.seen[:, index]]
        jobs.append(_Job(index, smalls[index], sources, mine, planes, nearest, farthest, seed))
    maps = dict(track(run_jobs(_map, jobs, workers), len(jobs), "depth maps"))
    return [maps[index] for index in range(len(smalls))]


def _ranges(cameras: Sequence[Camera], xyz: Array) -> list[tuple[float, float]]:
    """Depths between which to look, by camera: about those of the points in its picture, or else in all."""
    depths = []
    for camera in cameras:
        pixels, depth = camera.project(xyz)
        depths.append(depth[camera.is_in_image(pixels, depth)])
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
