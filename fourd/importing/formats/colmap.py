"""COLMAP: a sparse model of static cameras (text or binary), beside each camera's video or images.

The model's images are named CAM/FRAME.jpg or CAM.jpg. The origin of COLMAP's pixel coordinates is the corner of the
first pixel, as in fourd.
"""

from __future__ import annotations

import struct
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from fourd.cameras import Camera
from fourd.capture.layout import find_pictures
from fourd.errors import UserError
from fourd.importing.folders import find_frames, join_calibrations, list_entries, make_camera, parse_numbers
from fourd.importing.imported import Frames, Imported, PictureFiles
from fourd.limits import open_regular, read_limited
from fourd.processes.isolation import ParserProcess

MODEL_FOLDERS = (".", "sparse", "sparse/0")
PHOTO_FOLDERS = ("images", "input", ".")
"""Folders that may contain the photos CAM.jpg of a static scene, in order of preference."""
LENS_MODELS = {
    "SIMPLE_PINHOLE": (1, 0),
    "PINHOLE": (2, 0),
    "SIMPLE_RADIAL": (1, 1),
    "RADIAL": (1, 2),
    "OPENCV": (2, 4),
    "FULL_OPENCV": (2, 8),
}
"""Number of focal lengths and number of distortion coefficients of each lens model.

A lens model's parameters are the focal lengths, the principal point, and the distortion coefficients in OpenCV's order.
"""
PARAMETER_COUNTS = {0: 3, 1: 4, 2: 4, 3: 5, 4: 8, 5: 8, 6: 12, 7: 5, 8: 4, 9: 5, 10: 12}
"""Number of parameters of each lens model, keyed by the model's id in cameras.bin."""
MAX_MODEL_BYTES = 1 << 30
"""Maximum size in bytes of cameras.bin and of images.bin."""
MAX_MOTION = 1e-3
"""A camera is static if the pose of each of its images differs from the pose of its first image by at most this value.

The rotation difference is in radians. The position difference is relative to the size of the rig.
"""


@dataclass(frozen=True, eq=False)
class _Lens:
    """A camera of the COLMAP model: the lens model's name, the image size in pixels, and the parameters in COLMAP's
    order."""

    kind: str
    width: int
    height: int
    parameters: np.ndarray


@dataclass(frozen=True, eq=False)
class _Photo:
    """An image of the COLMAP model: name, number of its camera in the model, and world-to-camera matrix (3, 4)."""

    name: str
    lens: str
    pose: np.ndarray


def looks_like(source: Path) -> bool:
    """Return whether ``source``, or its subfolder sparse/ or sparse/0/, contains a COLMAP model."""
    return _find_model(source) is not None


def read(source: Path) -> Imported:
    """Read the cameras of ``source``, a folder with a COLMAP model and with the cameras' videos or images.

    Lengths are in the unit of the COLMAP model.

    Raises:
        UserError: when the model is damaged, a lens model is not one of LENS_MODELS, a camera's pose or intrinsics are
            not the same in all images, or no camera of the model has a video or images.
    """
    path = _find_model(source)
    if path is None:
        raise UserError(
            f"{source}: expected cameras.bin and images.bin (or .txt) in this folder or in sparse/0, got none; add both"
        )
    calibrations = read_cameras(path)
    frames = _find_photos(source, calibrations) or find_frames(source)
    cameras, notes = join_calibrations(frames, calibrations, path)
    unit = "lengths are kept in COLMAP's arbitrary unit"
    return Imported(cameras, (unit, *notes))


def read_cameras(path: Path) -> dict[str, Camera]:
    """Read a model folder. Returns the cameras, keyed by name.

    Raises:
        UserError: when the model is damaged or has no image with a pose, a lens model is not one of LENS_MODELS, a
            value is invalid, a camera's pose or intrinsics are not the same in all images, or two cameras have the same
            name.
    """
    lenses, photos = _read_model(path)
    images: dict[str, list[_Photo]] = defaultdict(list)
    for image in photos:
        file = PurePosixPath(image.name.replace("\\", "/"))
        images[file.parent.as_posix() if file.parent.name else file.stem].append(image)
    if not images:
        raise UserError(f"{path}: expected images with poses, got none; reconstruct again")
    centres = np.array([-image.pose[:, :3].T @ image.pose[:, 3] for image in photos])
    size = float(np.linalg.norm(np.ptp(centres, axis=0)))
    cameras: dict[str, Camera] = {}
    for folder, of_camera in images.items():
        name = PurePosixPath(folder).name
        where = f"{path}: camera '{name}'"
        if name in cameras:
            raise UserError(f"{where}: expected each camera once, got two folders with this name; rename one")
        cameras[name] = _make_camera(where, lenses, of_camera, size)
    return cameras


def _find_photos(source: Path, calibrations: Mapping[str, Camera]) -> dict[str, Frames]:
    """Find the photos CAM.jpg of a static scene, keyed by camera name. Each photo is one camera with one frame."""
    for folder in PHOTO_FOLDERS:
        found = find_pictures(source / folder)
        photos: dict[str, Frames] = {
            stem: PictureFiles((source / folder / file,)) for stem, file in found.items() if stem in calibrations
        }
        if photos:
            return photos
    return {}


def _make_camera(where: str, lenses: dict[str, _Lens], images: list[_Photo], rig_size: float) -> Camera:
    """Make a camera from its first image. Raises UserError if the camera's images differ from each other in pose or
    intrinsics."""
    lens, pose = lenses[images[0].lens], images[0].pose
    for image in images[1:]:
        other = image.pose
        angle = float(np.linalg.norm(other[:, :3] - pose[:, :3])) / np.sqrt(2)
        distance = float(np.linalg.norm(other[:, :3].T @ other[:, 3] - pose[:, :3].T @ pose[:, 3]))
        if not (angle <= MAX_MOTION and distance <= MAX_MOTION * rig_size):
            raise UserError(
                f"{where}: expected a static camera, got poses of {images[0].name} and {image.name} that differ by "
                f"{angle:.2g} rad and {distance:.2g} units; leave the moving camera out"
            )
        of_image = lenses[image.lens]
        is_same_kind = of_image.kind == lens.kind
        if not is_same_kind or not np.allclose(of_image.parameters, lens.parameters, rtol=1e-3, atol=1e-3):
            raise UserError(
                f"{where}: expected the same intrinsics for all images, got different intrinsics for "
                f"{images[0].name} and {image.name}; reconstruct with one camera per folder"
            )
    kind = lens.kind
    if kind not in LENS_MODELS:
        raise UserError(
            f"{where}: expected a lens model among {', '.join(LENS_MODELS)}, got {kind}; "
            "undistort the images with COLMAP, or reconstruct with OPENCV"
        )
    focals, coefficients = LENS_MODELS[kind]
    values = lens.parameters
    centre_x, centre_y = values[focals : focals + 2]
    intrinsics = np.array([[values[0], 0, centre_x], [0, values[focals - 1], centre_y], [0, 0, 1]])
    distortion = np.zeros(max(coefficients, 4))
    distortion[:coefficients] = values[focals + 2 :]
    return make_camera(where, intrinsics, pose[:, :3], pose[:, 3], (lens.width, lens.height), distortion)


def _read_model(path: Path) -> tuple[dict[str, _Lens], list[_Photo]]:
    """Read the lenses, keyed by camera number, and the registered images in the order of their names."""
    with ParserProcess() as parser:
        values = parser.call("fourd.importing.formats.colmap:read_in_child", path).value
    try:
        lenses = {
            str(number): _Lens(
                str(kind), int(width), int(height), parse_numbers(f"{path}: camera {number}", each, (-1,))
            )
            for number, (kind, width, height, each) in values["lenses"].items()
        }
        photos = [
            _Photo(str(name), str(lens), parse_numbers(f"{path}: image '{name}'", pose, (3, 4)))
            for name, lens, pose in values["images"]
        ]
        is_complete = all(image.lens in lenses for image in photos)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        is_complete = False
    if not is_complete:
        raise UserError(f"{path}: expected a COLMAP model, got images without a camera; reconstruct it again")
    return lenses, sorted(photos, key=lambda image: image.name)


def read_in_child(name: str) -> dict[str, Any]:
    """Read a model with pycolmap, and return JSON values. This function is called in a child process. Raises UserError
    if the model is damaged."""
    model = _load_model(Path(name))
    registered = [model.images[number] for number in model.reg_image_ids()]
    return {
        "lenses": {
            str(number): [camera.model.name, camera.width, camera.height, [float(value) for value in camera.params]]
            for number, camera in model.cameras.items()
        },
        "images": [[image.name, str(image.camera_id), _pose(image).tolist()] for image in registered],
    }


def _pose(image: Any) -> np.ndarray:
    """Return the world-to-camera matrix (3, 4). In pycolmap 3.12 and newer, ``cam_from_world`` is a method."""
    pose = image.cam_from_world
    return np.asarray((pose() if callable(pose) else pose).matrix(), np.float64)


def _load_model(path: Path) -> Any:
    # pycolmap is imported only here, because the import replaces the process's signal handlers.
    import pycolmap

    if (path / "cameras.bin").is_file():
        _check_whole(path)
    try:
        model = pycolmap.Reconstruction(str(path))
        for image in model.images.values():
            image.name.encode()  # pycolmap decodes an image's name only when the name is accessed
        return model
    except UnicodeDecodeError as error:
        raise UserError(f"{path}: expected image names in UTF-8, got other bytes; rename the image") from error
    except (ValueError, IndexError, KeyError, RuntimeError, MemoryError, OSError) as error:
        reason = str(error).partition("\n")[0].strip()
        raise UserError(f"{path}: expected a COLMAP model, got '{reason}'; copy or reconstruct it again") from error


def _check_whole(path: Path) -> None:
    """Raise UserError for truncated files, because pycolmap reads beyond the end of such files or hangs."""
    for name in ("rigs.bin", "cameras.bin", "frames.bin", "images.bin", "points3D.bin"):
        file = path / name
        if not file.is_file():
            continue
        try:
            content = read_limited(file, MAX_MODEL_BYTES) if name in ("cameras.bin", "images.bin") else b""
            with open_regular(file) as opened:
                (count,) = struct.unpack("<Q", opened.read(8))
            if 8 + 8 * count > file.stat().st_size:
                raise ValueError
            if content:
                offset = 8
                for _ in range(count):
                    offset = (_after_camera if name == "cameras.bin" else _after_image)(content, offset)
                if offset > len(content):
                    raise ValueError
        except (struct.error, ValueError, OSError) as error:
            raise UserError(f"{file}: expected a whole file, got a truncated one; copy it again") from error


def _after_camera(content: bytes, offset: int) -> int:
    _, kind, _, _ = struct.unpack_from("<IiQQ", content, offset)
    return offset + 24 + 8 * PARAMETER_COUNTS.get(kind, 3)


def _after_image(content: bytes, offset: int) -> int:
    name = offset + 4 + 56 + 4
    end = content.index(b"\0", name) + 1
    (points,) = struct.unpack_from("<Q", content, end)
    return end + 8 + 24 * int(points)


def _find_model(source: Path) -> Path | None:
    for folder in MODEL_FOLDERS:
        found = set(list_entries(source / folder))
        if {"cameras.bin", "images.bin"} <= found or {"cameras.txt", "images.txt"} <= found:
            return source / folder
    return None
