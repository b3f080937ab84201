"""Calibrates static cameras from their images alone, by structure from motion with COLMAP."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pycolmap
from numpy.typing import NDArray
from scipy.spatial import KDTree

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.recording.stereo.colmap import Extraction, Workspace, temporary_workspace

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
LensModel = Literal["SIMPLE_RADIAL", "OPENCV"]
PairMatches = dict[tuple[int, int], list[NDArray[np.uint32]]]

MIN_CAMERAS = 3
SAME_FEATURE_PX = 0.75
FIX = (
    "give the cameras more overlap (at most 30 degrees between neighbours), add texture to the scene, or provide a "
    "calibration"
)


@dataclass(frozen=True, eq=False)
class SelfCalibration:
    """Cameras reconstructed from images.

    Attributes:
        cameras: cameras with distortion by name; the origin, axes and unit of their world are arbitrary.
        error_px: mean reprojection error in pixels.
        points: number of triangulated points.
        missing: names of the cameras that could not be registered.
    """

    cameras: dict[str, Camera]
    error_px: float
    points: int
    missing: tuple[str, ...]


def calibrate_from_pictures(
    pictures: Mapping[str, Sequence[Picture]],
    *,
    lens_model: LensModel = "SIMPLE_RADIAL",
    is_lens_shared: bool = False,
    allows_missing: bool = False,
    seed: int = 0,
) -> SelfCalibration:
    """Estimate intrinsics and poses of static cameras from one or several frames.

    Features are matched between all pairs of cameras, and the cameras are registered incrementally (Schoenberger and
    Frahm, Structure-from-Motion Revisited, CVPR 2016). Repeated runs with the same images and seed differ by rounding
    errors, which amount to about 1e-5 of the scene's size.

    Args:
        pictures: RGB images (H, W, 3) uint8 of each camera by name; image k of every camera shows the same frame. One
            frame is enough. If most of the texture is on moving objects, use several frames that are far apart in time.
        lens_model: COLMAP's camera model: SIMPLE_RADIAL (one focal length, k1) or OPENCV (fx, fy, k1, k2, p1, p2). The
            principal point is fixed at the image centre. The model OPENCV needs texture near the images' corners.
        is_lens_shared: whether all cameras have the same intrinsics. Shared intrinsics make the estimate more stable,
            but require that all images have the same size.
        allows_missing: whether to return the registered cameras even if other cameras could not be registered.
        seed: seed of RANSAC, at least 0.

    Raises:
        ValueError: if a camera has no images, or cameras have different numbers of images.
        UserError: if there are fewer than 3 cameras, if cameras with a shared lens have images of different sizes, or
            if cameras could not be registered.
    """
    names = list(pictures)
    if len(names) < MIN_CAMERAS:
        raise UserError(f"cameras: expected at least {MIN_CAMERAS} for calibration, got {len(names)}; add cameras")
    frame_counts = {len(frames) for frames in pictures.values()}
    if len(frame_counts) != 1 or 0 in frame_counts:
        raise ValueError(f"pictures: expected the same number of frames for each camera, got {sorted(frame_counts)}")
    sizes = {frames[0].shape[1::-1] for frames in pictures.values()}
    if is_lens_shared and len(sizes) > 1:
        raise UserError(
            f"cameras with a shared lens: expected images of one size, got "
            f"{', '.join(f'{w} x {h}' for w, h in sorted(sizes))}; resize the images to one size"
        )
    with temporary_workspace("fourd-calibrate-") as workspace:
        frames = [list(frame) for frame in zip(*pictures.values(), strict=True)]
        settings = Extraction(lens_model, is_lens_shared, domain_size_pooling=True)
        model = _reconstruct(workspace.folder, frames, settings, seed)
    cameras = {} if model is None else _to_cameras(model, names)
    missing = tuple(name for name in names if name not in cameras)
    if model is None or len(cameras) < 2 or (missing and not allows_missing):
        unmatched = ", ".join(missing) if model is not None and len(cameras) >= 2 else "any camera"
        raise UserError(f"cameras: expected images with enough matches, got too few for {unmatched}; {FIX}")
    return SelfCalibration(cameras, float(model.compute_mean_reprojection_error()), model.num_points3D(), missing)


def _reconstruct(folder: Path, frames: list[list[Picture]], settings: Extraction, seed: int) -> Any | None:
    """Reconstruct with COLMAP and return the model with the most cameras; ``frames[k]`` contains frame k's images.

    Each camera is one COLMAP image that contains the features of all its frames. A static feature that is found in
    several frames is stored once. Features of two cameras are matched only if both were found in the same frame.
    """
    pycolmap.set_random_seed(seed)
    keypoints: list[Array] = [np.zeros((0, 2))] * len(frames[0])
    matches: PairMatches = {}
    workspaces = [Workspace(folder / f"{number:06d}") for number in range(len(frames))]
    for workspace, pictures in zip(workspaces, frames, strict=True):
        workspace.extract_features(pictures, settings)
        matching = pycolmap.FeatureMatchingOptions(use_gpu=False, skip_geometric_verification=True)
        pycolmap.match_exhaustive(workspace.database, matching_options=matching, device=pycolmap.Device.cpu)
        _merge_frame(workspace, keypoints, matches)
    _write_merged(workspaces[0], keypoints, matches)
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    verification.detect_watermark = False
    verifier = pycolmap.GeometricVerifierOptions(num_threads=1)
    pycolmap.geometric_verification(workspaces[0].database, verifier, two_view_geometry_options=verification)
    (folder / "models").mkdir()
    models = pycolmap.incremental_mapping(
        workspaces[0].database, workspaces[0].images, folder / "models", _mapping_options(seed)
    )
    return max(models.values(), key=lambda model: (model.num_reg_images(), model.num_points3D()), default=None)


def _merge_frame(workspace: Workspace, keypoints: list[Array], matches: PairMatches) -> None:
    """Add the features and matches of one frame to ``keypoints`` and ``matches``."""
    with workspace.open() as database:
        indices = []
        for camera in range(len(keypoints)):
            keypoints[camera], merged = _merge_keypoints(keypoints[camera], database.keypoints(camera))
            indices.append(merged)
        for i, j in combinations(range(len(keypoints)), 2):
            found = database.matches(i, j)
            matches.setdefault((i, j), []).append(
                np.column_stack([indices[i][found[:, 0]], indices[j][found[:, 1]]]).astype(np.uint32)
            )


def _merge_keypoints(known: Array, xy: Array) -> tuple[Array, NDArray[np.intp]]:
    """Add the keypoints ``xy`` (M, 2) to ``known``; merge those within 0.75 pixels of a known keypoint.

    Returns:
        all keypoints (N, 2), and for each keypoint of ``xy`` its index (M,) in all keypoints.
    """
    if not len(known):
        return np.asarray(xy, np.float64), np.arange(len(xy))
    distance, nearest = KDTree(known).query(xy)
    is_new = distance > SAME_FEATURE_PX
    indices = np.where(is_new, len(known) + np.cumsum(is_new) - 1, nearest)
    return np.vstack([known, xy[is_new]]), indices


def _write_merged(workspace: Workspace, keypoints: list[Array], matches: PairMatches) -> None:
    """Replace the features and matches of one frame by the merged features and matches of all frames."""
    with workspace.open() as database:
        database.replace_features(keypoints)
        for (i, j), parts in matches.items():
            if any(map(len, parts)):
                database.write_matches(i, j, np.unique(np.vstack(parts), axis=0), verified=False)


def _mapping_options(seed: int) -> Any:
    """Return COLMAP's mapping options for a few cameras with wide baselines."""
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = seed
    # With one thread, repeated runs differ only by rounding errors.
    options.num_threads = options.mapper.num_threads = 1
    options.min_model_size = MIN_CAMERAS
    options.extract_colors = False
    options.mapper.init_min_num_inliers = 40
    options.mapper.init_min_tri_angle = 8.0
    options.mapper.abs_pose_min_num_inliers = 15
    # With one image per camera, most points are seen in only two images. COLMAP ignores such points by default.
    options.triangulation.ignore_two_view_tracks = False
    return options


def _to_cameras(model: Any, names: list[str]) -> dict[str, Camera]:
    cameras = {}
    for image in model.images.values():
        if not image.has_pose:
            continue
        lens, pose = model.camera(image.camera_id), image.cam_from_world()
        # The centre of the first pixel is at (0.5, 0.5) in both COLMAP and fourd.
        extra = np.asarray(lens.params)[lens.extra_params_idxs()]
        distortion = np.concatenate([extra, np.zeros(3)])[:4] if len(extra) == 1 else extra
        cameras[names[int(Path(image.name).stem)]] = Camera(
            lens.calibration_matrix(), pose.rotation.matrix(), pose.translation, lens.width, lens.height, distortion
        )
    return {name: cameras[name] for name in names if name in cameras}
