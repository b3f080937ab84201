"""Sparse points of clean plates, from features that are matched along epipolar lines and that COLMAP triangulates with
fixed cameras."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from fourd.cameras import Camera
from fourd.parallel import core_count
from fourd.progress import Track
from fourd.stereo.features import (
    IMAGES,
    Features,
    QuietColmap,
    extract_features,
    fundamental_matrix,
    pairs_to_match,
    read_features,
    write_pictures,
)
from fourd.stereo.view import StereoView

Array = NDArray[np.float64]

EPIPOLAR_PX = 1.5
"""Maximum distance, in pixels, of a matched feature from the epipolar line."""
RATIO_TEST_THRESHOLD = 0.85
"""Maximum ratio d1 / d2 in Lowe's ratio test: d1 and d2 are the distances to the nearest and to the second nearest
descriptor."""
MIN_SIMILARITY = 0.5
"""Minimum cosine similarity of matched descriptors."""
MIN_ANGLE_DEG = 2.0
"""Minimum triangulation angle in degrees."""
MAX_ERROR_PX = 2.0
"""Maximum reprojection error in pixels."""


@dataclass(frozen=True, eq=False)
class SparsePoints:
    """Triangulated points.

    Attributes:
        xyz: (N, 3) float64 world points.
        seen: (N, V) bool, true if a feature of the point was detected in the plate.
    """

    xyz: Array
    seen: NDArray[np.bool_]

    @property
    def reliable(self) -> NDArray[np.bool_]:
        """(N,) bool, true for points that are seen in three plates or more.

        Other points are less reliable: on repetitive textures, half of the points that are seen in only two plates are
        wrong.
        """
        return self.seen.sum(axis=1) >= 3


def triangulate_sparse(plates: Sequence[StereoView], seed: int, track: Track) -> SparsePoints:
    """Triangulate features of two or more plates.

    Points with a triangulation angle below 2 degrees or a reprojection error above 2 px are dropped.
    """
    cameras = [plate.camera for plate in plates]
    with tempfile.TemporaryDirectory(prefix="fourd-plates-") as name, QuietColmap():
        folder = Path(name)
        database = folder / "database.db"
        names = write_pictures(folder, plates)
        batch = core_count()
        batches = [names[begin : begin + batch] for begin in range(0, len(names), batch)]
        for some in track(batches, len(batches), "features"):
            extract_features(folder, database, some)
        with closing(pycolmap.Database.open(database)) as store:
            images = sorted(store.read_all_images(), key=lambda image: image.name)
            features = [read_features(store, image.image_id) for image in images]
            pairs = pairs_to_match(cameras)
            for i, j in track(pairs, len(pairs), "matches"):
                found = _match_guided(features[i], features[j], cameras[i], cameras[j])
                if len(found):
                    geometry = pycolmap.TwoViewGeometry()
                    geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
                    geometry.inlier_matches = found
                    store.write_matches(images[i].image_id, images[j].image_id, found)
                    store.write_two_view_geometry(images[i].image_id, images[j].image_id, geometry)
            known = _known_cameras(store, images, cameras)
        (folder / "model").mkdir()
        model = pycolmap.triangulate_points(
            known, database, folder / IMAGES, folder / "model", True, _options(seed), False
        )
    return _read_points(model, len(plates))


def _match_guided(first: Features, second: Features, camera: Camera, other: Camera) -> NDArray[np.uint32]:
    """Match features of two images. Returns index pairs (M, 2) of mutual nearest neighbours that lie near the epipolar
    lines and pass the ratio test."""
    if min(len(first.xy), len(second.xy)) < 2:
        return np.zeros((0, 2), np.uint32)
    fundamental = fundamental_matrix(camera, other)
    first_xy, second_xy = (np.column_stack([f.xy, np.ones(len(f.xy))]) for f in (first, second))
    second_lines, first_lines = first_xy @ fundamental.T, second_xy @ fundamental
    for lines in (second_lines, first_lines):
        lines /= np.maximum(np.hypot(lines[:, 0], lines[:, 1]), 1e-12)[:, None]
    similarity = first.descriptors @ second.descriptors.T
    for a, b in ((second_lines, second_xy), (first_xy, first_lines)):
        similarity[np.abs(a.astype(np.float32) @ b.astype(np.float32).T) > EPIPOLAR_PX] = -1
    best = similarity.argmax(axis=1)
    mutual = similarity.argmax(axis=0)[best] == np.arange(len(best))
    nearest = np.partition(similarity, -2, axis=1)[:, -2:]
    distance = np.sqrt(np.maximum(2 - 2 * nearest, 0))
    kept = np.flatnonzero(
        mutual & (nearest[:, 1] > MIN_SIMILARITY) & (distance[:, 1] < RATIO_TEST_THRESHOLD * distance[:, 0])
    )
    return np.column_stack([kept, best[kept]]).astype(np.uint32)


def _known_cameras(store: Any, images: list[Any], cameras: Sequence[Camera]) -> Any:
    """Create a COLMAP reconstruction with the cameras and without points, and write the cameras' intrinsics to the
    database."""
    known = pycolmap.Reconstruction()
    for image, camera in zip(images, cameras, strict=True):
        lens = store.read_camera(image.camera_id)
        k = camera.intrinsics
        # The values need no conversion: both in COLMAP and in this project, the centre of the first pixel is at (0.5,
        # 0.5).
        lens.params = [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
        store.update_camera(lens)
        known.add_camera_with_trivial_rig(lens)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(camera.rotation), camera.translation)
        placed = pycolmap.Image(name=image.name, image_id=image.image_id, camera_id=image.camera_id)
        known.add_image_with_trivial_frame(placed, pose)
    return known


def _options(seed: int) -> Any:
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = seed
    options.num_threads = options.mapper.num_threads = 1
    options.min_num_matches = 1
    options.extract_colors = False
    options.fix_existing_frames = options.mapper.fix_existing_frames = True
    options.ba_refine_focal_length = options.ba_refine_principal_point = options.ba_refine_extra_params = False
    options.triangulation.ignore_two_view_tracks = False
    options.triangulation.min_angle = options.mapper.filter_min_tri_angle = MIN_ANGLE_DEG
    options.mapper.filter_max_reproj_error = MAX_ERROR_PX
    return options


def _read_points(model: Any, plates: int) -> SparsePoints:
    numbers = {identity: int(Path(image.name).stem) for identity, image in model.images.items()}
    points = [point for _, point in sorted(model.points3D.items())]
    seen = np.zeros((len(points), plates), bool)
    for row, point in enumerate(points):
        seen[row, [numbers[element.image_id] for element in point.track.elements]] = True
    return SparsePoints(np.array([point.xyz for point in points], np.float64).reshape(-1, 3), seen)
