"""Sparse points of clean plates, from features that are matched along epipolar lines and that COLMAP triangulates with
fixed cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.progress import Track
from fourd.recording.stereo.colmap import KNOWN_CAMERAS, Database, temporary_workspace
from fourd.recording.stereo.features import Features, fundamental_matrix, match_similar, pairs_to_match
from fourd.recording.stereo.view import StereoView

Array = NDArray[np.float64]

HOLE_MARGIN_PX = 6
"""Minimum distance in pixels between a feature and the holes of a plate, because plates are blurred near holes."""
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
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * HOLE_MARGIN_PX + 1,) * 2)
    masks = [np.asarray(cv2.erode(plate.seen.astype(np.uint8) * 255, disc), np.uint8) for plate in plates]
    with temporary_workspace("fourd-plates-") as workspace:
        workspace.extract_features([plate.rgb for plate in plates], KNOWN_CAMERAS, masks, track)
        with workspace.open() as database:
            features = [database.features(image) for image in range(len(plates))]
            pairs = pairs_to_match(cameras)
            for i, j in track(pairs, len(pairs), "matches"):
                found = _match_guided(features[i], features[j], cameras[i], cameras[j])
                if len(found):
                    database.write_matches(i, j, found, verified=True)
            known = _known_cameras(database, cameras)
        (workspace.folder / "model").mkdir()
        model = pycolmap.triangulate_points(
            known, workspace.database, workspace.images, workspace.folder / "model", True, _options(seed), False
        )
    return _read_points(model, len(plates))


def _match_guided(first: Features, second: Features, camera: Camera, other: Camera) -> NDArray[np.uint32]:
    """Match features of two images. Returns index pairs (M, 2) of mutual nearest neighbours that lie near the epipolar
    lines and pass the ratio test."""
    if min(len(first.xy_px), len(second.xy_px)) < 2:
        return np.zeros((0, 2), np.uint32)
    fundamental = fundamental_matrix(camera, other)
    first_xy, second_xy = (np.column_stack([f.xy_px, np.ones(len(f.xy_px))]) for f in (first, second))
    second_lines, first_lines = first_xy @ fundamental.T, second_xy @ fundamental
    for lines in (second_lines, first_lines):
        lines /= np.maximum(np.hypot(lines[:, 0], lines[:, 1]), 1e-12)[:, None]
    similarity = first.descriptors @ second.descriptors.T
    for a, b in ((second_lines, second_xy), (first_xy, first_lines)):
        similarity[np.abs(a.astype(np.float32) @ b.astype(np.float32).T) > EPIPOLAR_PX] = -1
    return match_similar(similarity, RATIO_TEST_THRESHOLD, MIN_SIMILARITY).astype(np.uint32)


def _known_cameras(database: Database, cameras: Sequence[Camera]) -> Any:
    """Create a COLMAP reconstruction with the cameras and without points, and write the cameras' intrinsics to the
    database."""
    known = pycolmap.Reconstruction()
    for index, (image, camera) in enumerate(zip(database.images, cameras, strict=True)):
        lens = database.write_pinhole(index, camera.intrinsics)
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
