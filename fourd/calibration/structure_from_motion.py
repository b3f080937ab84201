"""Cameras from the pictures alone (structure from motion by COLMAP), and what gives them a scale and an origin."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray
from scipy.spatial import KDTree

from fourd.cameras import Camera
from fourd.errors import UserError

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
Lens = Literal["SIMPLE_RADIAL", "OPENCV"]

LEAST_CAMERAS = 3
SAME_PLACE_PX = 0.75
MOST_FEATURES = 4096
FAINTEST = 0.003
"""COLMAP takes 0.0067. With few pictures faint features are needed: a real ring of 20 cameras joins up by them."""
MEND = "give the cameras more overlap (neighbours within 30 degrees) and the scene more texture, or a fixed calibration"


@dataclass(frozen=True, eq=False)
class SelfCalibration:
    """Cameras that were found from pictures.

    Attributes:
        cameras: by name, with distortion; world origin, axes and unit are arbitrary.
        error_px: mean distance of the features from where their points project.
        points: number of points that were found.
        missing: cameras that could not be placed.
    """

    cameras: dict[str, Camera]
    error_px: float
    points: int
    missing: tuple[str, ...]


def calibrate(
    pictures: Mapping[str, Sequence[Picture]],
    *,
    lens: Lens = "SIMPLE_RADIAL",
    shared: bool = False,
    partial: bool = False,
    seed: int = 0,
) -> SelfCalibration:
    """Find intrinsics and poses of cameras that stand still, from a picture of each or from several moments.

    Features of all pairs are matched and the cameras placed one after the other (Schoenberger and
    Frahm, Structure-from-Motion Revisited, CVPR 2016). The same pictures and seed give the same
    cameras, to about 1e-5 of the scene's size: COLMAP's threads sum in any order.

    Args:
        pictures: by the camera's name its RGB pictures (H, W, 3) uint8, picture k of all cameras at one
            moment. One will do; some more, far apart in time, help where what moves has the texture.
        lens: SIMPLE_RADIAL (one focal length, k1) or OPENCV (fx, fy, k1, k2, p1, p2); the principal
            point stays in the middle. OPENCV wants much texture near the pictures' corners.
        shared: whether all cameras have one lens, which steadies it; they must be of one size.
        partial: whether to return what was found where some cameras could not be placed.
        seed: of RANSAC, at least 0.

    Raises:
        ValueError: where cameras have different numbers of pictures, or none.
        UserError: fewer than 3 cameras, sizes that differ though the lens is shared, and cameras that could
            not be placed, named with the mend.
    """
    names = list(pictures)
    if len(names) < LEAST_CAMERAS:
        raise UserError(f"cameras: expected at least {LEAST_CAMERAS} to calibrate, got {len(names)}; add views")
    moments = {len(frames) for frames in pictures.values()}
    if len(moments) != 1 or 0 in moments:
        raise ValueError(f"pictures: expected as many frames of each camera, got {sorted(moments)}")
    sizes = {frames[0].shape[1::-1] for frames in pictures.values()}
    if shared and len(sizes) > 1:
        raise UserError(
            f"--shared: expected pictures of one size, got {', '.join(f'{w} x {h}' for w, h in sorted(sizes))}; "
            "let each camera have its own lens"
        )
    with tempfile.TemporaryDirectory(prefix="fourd-calibrate-") as folder, _quiet():
        found = _reconstruct(
            Path(folder), [list(at) for at in zip(*pictures.values(), strict=True)], lens, shared, seed
        )
    cameras = {} if found is None else _cameras(found, names)
    missing = tuple(name for name in names if name not in cameras)
    if found is None or len(cameras) < 2 or (missing and not partial):
        who = ", ".join(missing) if found is not None and len(cameras) >= 2 else "any camera"
        raise UserError(f"cameras: expected pictures that match, got none for {who}; {MEND}")
    return SelfCalibration(cameras, float(found.compute_mean_reprojection_error()), found.num_points3D(), missing)


def _reconstruct(folder: Path, frames: list[list[Picture]], lens: Lens, shared: bool, seed: int) -> Any | None:
    """The reconstruction with most cameras. ``frames`` has the cameras' pictures of each moment.

    A camera is one image of COLMAP's, with the features of all its frames: cameras do not move, and
    what moves before them is matched within a moment only.
    """
    pycolmap.set_random_seed(seed)
    places: list[Array] = [np.zeros((0, 2))] * len(frames[0])
    pairs: dict[tuple[int, int], list[NDArray[np.uint32]]] = {}
    for moment, pictures in enumerate(frames):
        database = _matched(folder / f"{moment:06d}", pictures, lens, shared)
        with closing(pycolmap.Database.open(database)) as store:
            images = sorted(store.read_all_images(), key=lambda image: image.name)
            numbers = []
            for camera, image in enumerate(images):
                places[camera], number = _joined(
                    places[camera], np.asarray(store.read_keypoints(image.image_id), np.float64)[:, :2]
                )
                numbers.append(number)
            for i, j in combinations(range(len(images)), 2):
                found = store.read_matches(images[i].image_id, images[j].image_id)
                pairs.setdefault((i, j), []).append(
                    np.column_stack([numbers[i][found[:, 0]], numbers[j][found[:, 1]]]).astype(np.uint32)
                )
    database, pictures_folder = folder / "000000" / "database.db", folder / "000000" / "images"
    with closing(pycolmap.Database.open(database)) as store:
        images = sorted(store.read_all_images(), key=lambda image: image.name)
        for clear in (store.clear_keypoints, store.clear_descriptors, store.clear_matches):
            clear()
        for image, xy in zip(images, places, strict=True):
            store.write_keypoints(image.image_id, xy.astype(np.float32))
        for (i, j), parts in pairs.items():
            if any(map(len, parts)):
                store.write_matches(images[i].image_id, images[j].image_id, np.unique(np.vstack(parts), axis=0))
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = seed
    verification.detect_watermark = False
    verifier = pycolmap.GeometricVerifierOptions(num_threads=1)
    pycolmap.geometric_verification(database, verifier, two_view_geometry_options=verification)
    (folder / "models").mkdir()
    models = pycolmap.incremental_mapping(database, pictures_folder, folder / "models", _mapping(seed))
    return max(models.values(), key=lambda model: (model.num_reg_images(), model.num_points3D()), default=None)


def _matched(folder: Path, pictures: list[Picture], lens: Lens, shared: bool) -> Path:
    """A database of one moment; files are named by number, since cameras' names may not be file names."""
    images, database = folder / "images", folder / "database.db"
    images.mkdir(parents=True)
    for index, picture in enumerate(pictures):
        if not cv2.imwrite(str(images / f"{index:06d}.png"), cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)):
            raise OSError(f"{images}: a temporary picture could not be written")
    extraction = pycolmap.FeatureExtractionOptions(use_gpu=False)
    # Cameras of a ring stand 18 degrees apart or more: features that follow the surface's slant are what they share.
    extraction.sift.estimate_affine_shape = True
    extraction.sift.domain_size_pooling = True
    extraction.sift.peak_threshold = FAINTEST
    extraction.sift.max_num_features = MOST_FEATURES
    reader = pycolmap.ImageReaderOptions(camera_model=lens)
    mode = pycolmap.CameraMode.SINGLE if shared else pycolmap.CameraMode.PER_IMAGE
    device = pycolmap.Device.cpu
    pycolmap.extract_features(database, images, [], mode, reader, extraction, device)
    matching = pycolmap.FeatureMatchingOptions(use_gpu=False, skip_geometric_verification=True)
    pycolmap.match_exhaustive(database, matching_options=matching, device=device)
    return database


def _joined(places: Array, more: Array) -> tuple[Array, NDArray[np.intp]]:
    """All places (N, 2), and the numbers there of ``more`` (M, 2): those within a pixel of a known one are that one."""
    if not len(places):
        return np.asarray(more, np.float64), np.arange(len(more))
    apart, nearest = KDTree(places).query(more)
    is_new = apart > SAME_PLACE_PX
    numbers = np.where(is_new, len(places) + np.cumsum(is_new) - 1, nearest)
    return np.vstack([places, more[is_new]]), numbers


def _mapping(seed: int) -> Any:
    """COLMAP's own settings, but for few cameras that stand apart instead of many photos."""
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed = options.mapper.random_seed = options.triangulation.random_seed = seed
    # One thread keeps the cameras the same from run to run, but for rounding.
    options.num_threads = options.mapper.num_threads = 1
    options.min_model_size = LEAST_CAMERAS
    options.extract_colors = False
    options.mapper.init_min_num_inliers = 40
    options.mapper.init_min_tri_angle = 8.0
    options.mapper.abs_pose_min_num_inliers = 15
    # With one picture a camera most points are seen by two cameras only, and they count.
    options.triangulation.ignore_two_view_tracks = False
    return options


def _cameras(found: Any, names: list[str]) -> dict[str, Camera]:
    cameras = {}
    for image in found.images.values():
        if not image.has_pose:
            continue
        lens, pose = found.camera(image.camera_id), image.cam_from_world()
        # COLMAP's first pixel has its centre at (0.5, 0.5), as this project's has.
        extra = np.asarray(lens.params)[lens.extra_params_idxs()]
        distortion = np.concatenate([extra, np.zeros(3)])[:4] if len(extra) == 1 else extra
        cameras[names[int(Path(image.name).stem)]] = Camera(
            lens.calibration_matrix(), pose.rotation.matrix(), pose.translation, lens.width, lens.height, distortion
        )
    return {name: cameras[name] for name in names if name in cameras}


@contextmanager
def _quiet() -> Iterator[None]:
    """COLMAP tells its progress on stderr, line by line; errors still show."""
    logging = pycolmap.logging
    before = logging.minloglevel
    logging.minloglevel = int(logging.ERROR)
    try:
        yield
    finally:
        logging.minloglevel = before


def scaled(cameras: Mapping[str, Camera], pair: tuple[str, str], distance: float) -> dict[str, Camera]:
    """The cameras in the unit of ``distance``, which is that between the centres of the two cameras ``pair``.

    Raises:
        UserError: for a name that is none of the cameras, twice one name, or a distance that is not above 0.
    """
    for name in pair:
        if name not in cameras:
            raise UserError(f"{name}: expected one of {', '.join(cameras)}, got another name; name a calibrated camera")
    first, second = (cameras[name].centre for name in pair)
    apart = float(np.linalg.norm(first - second))
    if not (np.isfinite(distance) and distance > 0 and apart > 0):
        raise UserError(
            f"{pair[0]}, {pair[1]}: expected two cameras apart and their distance above 0, got {distance:g}; "
            "measure between the middles of their lenses"
        )
    return {
        name: replace(camera, translation=camera.translation * distance / apart) for name, camera in cameras.items()
    }


def board_pose(picture: Picture, lens: Camera, columns: int, rows: int, square_m: float) -> Camera:
    """The camera's pose with respect to a chessboard in its picture, in metres.

    The world's origin is the inner corner at one end of the board from which x runs along the
    ``columns`` corners, y across them, z off the board towards the camera, and at which the square at
    x, y > 0 is black. Where ``columns + rows`` is odd this is one corner, the same from everywhere;
    else the board looks the same when turned by 180 degrees, and it is either of two.

    Args:
        picture: RGB (H, W, 3) uint8, as the lens sees it.
        lens: intrinsics and distortion; its pose is not used.
        columns: inner corners along one side, at least 3; ``rows``: along the other, another number.
        square_m: side of a square in metres.

    Raises:
        UserError: for numbers out of range, and where the board is not seen whole.
    """
    if min(columns, rows) < 3 or not (np.isfinite(square_m) and square_m > 0):
        raise UserError(
            f"board: expected at least 3 x 3 inner corners and a side above 0 m, got {columns} x {rows} and "
            f"{square_m:g} m; count where four squares meet"
        )
    grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), np.uint8)
    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
    found, corners = cv2.findChessboardCornersSB(grey, (columns, rows), flags=flags)
    if not found:
        raise UserError(
            f"board: expected a chessboard of {columns} x {rows} inner corners, got none in the picture; show all "
            "of it with a white margin, flat, sharp and without glare"
        )
    pixels = corners.reshape(rows, columns, 2).astype(np.float64)
    along, across = pixels[0, -1] - pixels[0, 0], pixels[-1, 0] - pixels[0, 0]
    if along[0] * across[1] - along[1] * across[0] > 0:
        # Seen from above with y up, x and y turn against the clock; in a picture, whose y is down, this is the sign.
        pixels = pixels[::-1]
    if _first_square_is_bright(grey, pixels):
        pixels = pixels[::-1, ::-1]
    j, i = np.meshgrid(np.arange(columns), np.arange(rows))
    board = square_m * np.stack([j, i, np.zeros_like(i)], axis=-1).reshape(-1, 3)
    # OpenCV counts pixels from their centres.
    seen = pixels.reshape(-1, 2) + 0.5
    _, turn, shift = cv2.solvePnP(board, seen, lens.intrinsics, lens.distortion, flags=cv2.SOLVEPNP_IPPE)
    turn, shift = cv2.solvePnPRefineLM(board, seen, lens.intrinsics, lens.distortion, turn, shift)
    rotation = np.asarray(cv2.Rodrigues(turn)[0], np.float64)
    return replace(lens, rotation=rotation, translation=np.asarray(shift, np.float64).ravel())


def _first_square_is_bright(grey: Picture, corners: Array) -> bool:
    """Whether the square between the first four corners (rows, columns, 2) is brighter than its neighbour."""
    values = [
        float(
            cv2.getRectSubPix(grey, (3, 3), tuple(map(float, corners[:2, left : right + 1].mean(axis=(0, 1))))).mean()
        )
        for left, right in pairwise(range(3))
    ]
    return values[0] > values[1]


def placed(cameras: Mapping[str, Camera], poses: Mapping[str, Camera]) -> dict[str, Camera]:
    """All cameras, moved into the world in which some of them have the given ``poses`` (of :func:`board_pose`).

    One pose turns and moves; the unit stays, so scale first. Two poses or more give the scale too:
    the turn is the mean of theirs, scale and shift fit their centres.

    Raises:
        UserError: where no pose is of a camera that was calibrated.
    """
    known = [name for name in poses if name in cameras]
    if not known:
        raise UserError("board: expected it in the picture of a calibrated camera, got none; show it to one of them")
    u, _, vt = np.linalg.svd(sum(poses[name].rotation.T @ cameras[name].rotation for name in known))
    R_new_old = u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt
    old = np.stack([R_new_old @ cameras[name].centre for name in known])
    new = np.stack([poses[name].centre for name in known])
    spread_old, spread_new = old - old.mean(axis=0), new - new.mean(axis=0)
    size = float((spread_old**2).sum())
    scale = float((spread_old * spread_new).sum()) / size if size > 0 else 1.0
    shift = new.mean(axis=0) - scale * old.mean(axis=0)
    moved = {}
    for name, camera in cameras.items():
        rotation = camera.rotation @ R_new_old.T
        centre = scale * R_new_old @ camera.centre + shift
        moved[name] = replace(camera, rotation=rotation, translation=-rotation @ centre)
    return moved
