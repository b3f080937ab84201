"""Stereo reconstruction of clean plates (images of the empty scene): estimate a depth map of each plate, and remove
depths that are inconsistent with other plates. Images of all cameras at one moment serve as plates too.

A depth map is a grid of cells. Each cell is centred on a pixel and stores a plane in space.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.parallel import run_jobs
from fourd.base.progress import Track
from fourd.recording.stereo.fusion import Surface, fuse_depth_maps
from fourd.recording.stereo.patches import Floats, GreyView, Grid
from fourd.recording.stereo.patchmatch import DepthMap, estimate_depth_map
from fourd.recording.stereo.plane_hypotheses import PLANE_TOLERANCE, find_large_planes, plane_in_view, triangle_planes
from fourd.recording.stereo.source_selection import select_sources
from fourd.recording.stereo.sparse import SparsePoints, triangulate_sparse
from fourd.recording.stereo.view import StereoView

Array = NDArray[np.float64]

MAX_SIDE_PX = 640
"""Maximum length of a plate's longer side in pixels. Larger plates are reduced to this size for stereo."""
MAX_CELLS = 16384
"""Maximum number of cells of a depth map."""
MIN_FEATURES = 8
"""Minimum number of triangulated points that are needed to estimate a depth range."""
MIN_RELIABLE = 30
"""Minimum number of points that are seen in three or more plates. If there are fewer, points that are seen in only two
plates are also used."""
NEAR_FACTOR, FAR_FACTOR = 0.5, 4.0
"""Factors that widen the depth range: the first multiplies the 1st percentile of the triangulated points' depths, and
the second multiplies the 99th."""


@dataclass(frozen=True, eq=False)
class StereoResult:
    """Result of stereo on clean plates.

    Attributes:
        feature_count: number of triangulated points.
        reliable_count: number of triangulated points that are seen in three plates or more.
        plates: the plates at the size used for stereo.
        surfaces: one surface per plate. All cells are unknown if there are fewer than 8 triangulated points.
        feature_depths: one array per plate, the camera depths of the points that are seen in three plates or more and
            whose feature was detected in this plate.
    """

    feature_count: int
    reliable_count: int
    plates: list[ReducedPlate]
    surfaces: list[Surface]
    feature_depths: tuple[Array, ...] = ()

    @property
    def measured_cells(self) -> int:
        """Number of depth-map cells with a measured depth."""
        return sum(int(surface.known.sum()) for surface in self.surfaces)

    @property
    def visible_cells(self) -> int:
        """Number of depth-map cells outside the plates' holes (areas that do not show the background), at least 1."""
        return max(1, sum(int(plate.seen[plate.grid().indices].sum()) for plate in self.plates))

    @property
    def measured_share(self) -> float:
        """Fraction, in [0, 1], of the visible cells that have a measured depth."""
        return self.measured_cells / self.visible_cells


def reconstruct_surfaces(plates: Sequence[StereoView], seed: int, workers: int, track: Track) -> StereoResult:
    """Triangulate features, estimate a depth map of each plate, and keep depths that are consistent across plates."""
    features = triangulate_sparse(plates, seed, track)
    reduced = [ReducedPlate.from_plate(plate) for plate in plates]
    cameras = [plate.camera for plate in reduced]
    if len(features.xyz) < MIN_FEATURES:
        maps = [DepthMap.unknown(plate.grid()) for plate in reduced]
    else:
        maps = _estimate_maps(reduced, features, seed, workers, track)
    depths = tuple(
        plate.camera.project(features.xyz[features.reliable & features.seen[:, index]])[1]
        for index, plate in enumerate(plates)
    )
    return StereoResult(
        len(features.xyz), int(features.reliable.sum()), reduced, fuse_depth_maps(cameras, maps), depths
    )


@dataclass(frozen=True, eq=False)
class ReducedPlate:
    """A plate reduced to the size used for stereo.

    Attributes:
        camera: pinhole camera of the reduced plate.
        rgb: (H, W, 3) uint8 colours.
        seen: (H, W) bool, true for pixels in whose whole area the plate shows the background.
    """

    camera: Camera
    rgb: NDArray[np.uint8]
    seen: NDArray[np.bool_]

    @staticmethod
    def from_plate(plate: StereoView) -> ReducedPlate:
        """Reduce a plate to the size used for stereo."""
        scale = min(1.0, MAX_SIDE_PX / max(plate.camera.width, plate.camera.height))
        camera = plate.camera.rescale(scale)
        size = (camera.width, camera.height)
        rgb = cv2.resize(plate.rgb, size, interpolation=cv2.INTER_AREA)
        share = cv2.resize(plate.seen.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        return ReducedPlate(camera, np.asarray(rgb, np.uint8), share > 0.999)

    def grey_view(self) -> GreyView:
        """Convert the plate to a pyramid of grey images for patch comparison."""
        return GreyView.from_rgb(self.camera, self.rgb, self.seen)

    def grid(self) -> Grid:
        """Create the cells of the plate's depth map."""
        stride = int(np.ceil(np.sqrt(self.camera.width * self.camera.height / MAX_CELLS)))
        return Grid.covering(self.camera.width, self.camera.height, stride)


@dataclass(frozen=True, eq=False)
class _Job:
    """Inputs of a worker process that estimates one depth map."""

    index: int
    plate: ReducedPlate
    sources: tuple[ReducedPlate, ...]
    features: Array
    planes: Array
    nearest: float
    farthest: float
    seed: int


def _estimate_maps(
    plates: Sequence[ReducedPlate], features: SparsePoints, seed: int, workers: int, track: Track
) -> list[DepthMap]:
    """Estimate a depth map of each plate."""
    cameras = [plate.camera for plate in plates]
    kept = features.reliable if features.reliable.sum() >= MIN_RELIABLE else np.ones(len(features.xyz), bool)
    distances = np.concatenate([np.linalg.norm(features.xyz[kept] - camera.centre, axis=1) for camera in cameras])
    rng = np.random.default_rng(seed)
    planes = find_large_planes(
        features.xyz, features.seen.sum(axis=1) - 1.0, PLANE_TOLERANCE * float(np.median(distances)), rng
    )
    ranges = _depth_ranges(cameras, features.xyz[kept])
    jobs = []
    for index, (nearest, farthest) in enumerate(ranges):
        sources = tuple(plates[other] for other in select_sources(cameras, index, nearest, farthest))
        own = features.xyz[features.seen[:, index]]
        jobs.append(_Job(index, plates[index], sources, own, planes, nearest, farthest, seed))
    maps = dict(track(run_jobs(_estimate_map, jobs, workers), len(jobs), "depth maps"))
    return [maps[index] for index in range(len(plates))]


def _depth_ranges(cameras: Sequence[Camera], xyz: Array) -> list[tuple[float, float]]:
    """Compute the depth range of each camera from the depths of the triangulated points in its image. If its image
    contains too few points, the range is computed from the points in all images."""
    depths = []
    for camera in cameras:
        pixels, depth = camera.project(xyz)
        depths.append(depth[camera.is_in_image(pixels, depth)])
    everything = np.concatenate(depths)
    ends = [np.percentile(own if len(own) >= MIN_FEATURES else everything, (1, 99)) for own in depths]
    return [(NEAR_FACTOR * float(low), FAR_FACTOR * float(high)) for low, high in ends]


def _estimate_map(job: _Job) -> Iterator[tuple[int, DepthMap]]:
    """Estimate one depth map in a worker process. Yields the plate's index and the depth map."""
    grid, camera = job.plate.grid(), job.plate.camera
    hypotheses: list[Floats] = [plane_in_view(plane, camera, grid) for plane in job.planes]
    hypotheses += triangle_planes(job.features, camera, grid)
    sources = [source.grey_view() for source in job.sources]
    view = job.plate.grey_view()
    yield (
        job.index,
        estimate_depth_map(view, sources, grid, hypotheses, job.nearest, job.farthest, job.seed + job.index),
    )
