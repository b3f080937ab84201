"""COLMAP: a sparse model of static cameras (text or binary), beside each camera's video or images.

The model's images are named CAM/FRAME.jpg or CAM.jpg, in any number of outer folders. The origin of COLMAP's pixel
coordinates is the corner of the first pixel, as in fourd.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.recording.capture.layout import PICTURE_SUFFIXES, find_videos, frame_name
from fourd.recording.importing.folders import (
    FRAME_FOLDERS,
    find_frames,
    join_calibrations,
    list_entries,
    make_camera,
    match_names,
    picture_files,
)
from fourd.recording.importing.imported import Frames, Imported, PictureFiles, VideoFile
from fourd.recording.importing.readers.colmap_model import Lens, Photo, model_suffix, read_model

MODEL_FOLDERS = (".", "sparse", "sparse/0", "colmap/sparse/0")
IMAGE_FOLDERS = ("images", "input", ".")
"""Folders to which the names of a model's images may be relative, in order of preference. They are searched in the
source, and in the folder that contains the model's folders."""
MAX_SHOWN = 5
"""Maximum number of names that a note lists."""
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
MAX_MOTION = 1e-3
"""A camera is static if the pose of each of its images differs from the pose of its first image by at most this value.

The rotation difference is in radians. The position difference is relative to the size of the rig.
"""


@dataclass(frozen=True, eq=False)
class _ModelCamera:
    """A camera of the capture.

    Attributes:
        calibration: its calibration.
        files: the model's names of its images.
        is_photo: whether the camera is one photo of a static scene. Otherwise, the images are in a folder of their own.
    """

    calibration: Camera
    files: tuple[PurePosixPath, ...]
    is_photo: bool


def looks_like(source: Path) -> bool:
    """Return whether ``source``, or its subfolder sparse/ or sparse/0/, contains a COLMAP model."""
    return _find_model(source) is not None


def read(source: Path) -> Imported:
    """Read the cameras of ``source``, a folder with a COLMAP model and with the cameras' videos or images.

    Lengths are in the unit of the COLMAP model. The images are found by their names in the model. Images of a static
    camera that the model does not name are imported too, and photos and folders that the model does not name are not.

    Raises:
        UserError: when the model is damaged, a lens model is not one of LENS_MODELS, a camera's pose or intrinsics are
            not the same in all images, or no camera of the model has a video or images.
    """
    path = _find_model(source)
    if path is None:
        raise UserError(
            f"{source}: expected cameras.bin and images.bin (or .txt) in this folder or in sparse/0, got none; add both"
        )
    model = _read_cameras(path)
    calibrations = {name: camera.calibration for name, camera in model.items()}
    frames, notes = _find_videos(source, list(calibrations), path)
    if not frames:
        frames, notes = _find_images(source, path, model)
    cameras, more = join_calibrations(frames or find_frames(source), calibrations, path)
    return Imported(cameras, ("lengths are kept in COLMAP's arbitrary unit", *notes, *more))


def _read_cameras(path: Path) -> dict[str, _ModelCamera]:
    """Read a model folder. Returns the cameras, keyed by name. Cameras are named after their folders, or after the
    whole paths of their folders if two folders have the same name.

    Raises:
        UserError: when the model is damaged or has no image with a pose, a lens model is not one of LENS_MODELS, a
            value is invalid, or a camera's pose or intrinsics are not the same in all images.
    """
    lenses, photos = read_model(path)
    if not photos:
        raise UserError(f"{path}: expected images with poses, got none; reconstruct again")
    files = [_relative(path, photo.name) for photo in photos]
    tops = {file.parts[:1] for file in files if len(file.parts) > 1}
    # Names that start with the folder of all images are relative to the folder above it.
    roots = [PurePosixPath(), *(PurePosixPath(*top) for top in tops if top[0] in IMAGE_FOLDERS)]
    images: dict[PurePosixPath, list[int]] = {}
    for index, file in enumerate(files):
        images.setdefault(file if file.parent in roots else file.parent, []).append(index)
    all_files = set(files)
    has_unique_names = len({_label(key, key in all_files) for key in images}) == len(images)
    centres = np.array([-photo.pose[:, :3].T @ photo.pose[:, 3] for photo in photos])
    size = float(np.linalg.norm(np.ptp(centres, axis=0)))
    cameras: dict[str, _ModelCamera] = {}
    for key, indices in images.items():
        is_photo = key in all_files
        name = _label(key, is_photo)
        name = name if has_unique_names else "_".join((*key.parts[:-1], name))
        where = f"{path}: camera '{name}'"
        if name in cameras:
            raise UserError(f"{where}: expected each camera once, got two images or folders with this name; rename one")
        calibration = _make_camera(where, lenses, [photos[index] for index in indices], size)
        cameras[name] = _ModelCamera(calibration, tuple(files[index] for index in indices), is_photo)
    return cameras


def _relative(path: Path, name: str) -> PurePosixPath:
    file = PurePosixPath(name.replace("\\", "/"))
    if file.is_absolute() or ".." in file.parts or "\0" in name or not file.parts:
        raise UserError(f"{path}: expected image names within the folder of the images, got '{name}'; rename the image")
    return file


def _label(key: PurePosixPath, is_photo: bool) -> str:
    return key.stem if is_photo else key.name


def _find_videos(source: Path, names: Sequence[str], model: Path) -> tuple[dict[str, Frames], list[str]]:
    """Find videos of the model's cameras, and return them with notes for the user. Videos are preferred to the model's
    images, which are often single frames of them."""
    for folder in FRAME_FOLDERS:
        videos = find_videos(source / folder)
        if videos:
            try:
                match_names(names, videos, model)
            except UserError:
                return {}, []
            has_images = any((source / folder).is_dir() for folder in IMAGE_FOLDERS[:2])
            note = f"the videos in {source / folder} are imported, and not the images of the model"
            return {name: VideoFile(path) for name, path in videos.items()}, [note] * has_images
    return {}, []


def _find_images(source: Path, model: Path, cameras: Mapping[str, _ModelCamera]) -> tuple[dict[str, Frames], list[str]]:
    """Find the images of the model's cameras, and return them with notes for the user. No images are found if the
    source has none of the files that the model names."""
    folders = (source, model.parent, model.parent.parent) if model == source else (source,)
    bases = [folder / name for folder in folders for name in IMAGE_FOLDERS]
    counts = [sum(any((base / file).is_file() for file in of.files) for of in cameras.values()) for base in bases]
    base = bases[int(np.argmax(counts))]
    if not max(counts):
        return {}, []
    found: dict[str, Frames] = {}
    unnamed = 0
    for name, camera in cameras.items():
        frames = _photo(base, camera) if camera.is_photo else picture_files(base / camera.files[0].parent)
        if frames is not None:
            found[name] = frames
            unnamed += len(frames.paths) - len({*frames.paths} & {base / file for file in camera.files})
    notes = [f"images: {base}"] if base not in (source / "images", source) else []
    if unnamed:
        notes.append(
            f"{unnamed} images in the cameras' folders are imported although the model does not name them, because the "
            "cameras are static"
        )
    return found, [*notes, *_unnamed(base, cameras)]


def _photo(base: Path, camera: _ModelCamera) -> PictureFiles | None:
    file = base / camera.files[0]
    if file.is_file() and file.suffix.lower() not in PICTURE_SUFFIXES:
        raise UserError(
            f"{file}: expected an image with the suffix {', '.join(PICTURE_SUFFIXES)}, got {file.suffix or 'none'}; "
            "convert the images, and rename them in the model"
        )
    return PictureFiles((file,), (frame_name(0),)) if file.is_file() else None


def _unnamed(base: Path, cameras: Mapping[str, _ModelCamera]) -> list[str]:
    """Return notes on photos and folders of images that lie beside the model's images, but that the model does not
    name."""
    named = {base / file for of in cameras.values() for file in of.files}
    own = {base / file.parent for of in cameras.values() if not of.is_photo for file in of.files}
    above = {parent for file in named for parent in file.parents}
    beside = {file.parent for file in named if file.parent not in own} | {folder.parent for folder in own - {base}}
    photos, folders = [], []
    for path in (folder / entry for folder in sorted(beside) for entry in list_entries(folder)):
        if path.suffix.lower() in PICTURE_SUFFIXES and path not in named and not path.name.startswith("."):
            photos.append(path.relative_to(base).as_posix())
        elif path not in above and not path.name.startswith(".") and _has_pictures(path):
            folders.append(path.relative_to(base).as_posix())
    return [
        f"{kind} that the model does not name, not imported: {', '.join(names[:MAX_SHOWN])}"
        + (f" and {len(names) - MAX_SHOWN} more" if len(names) > MAX_SHOWN else "")
        for kind, names in (("photos", photos), ("folders", folders))
        if names
    ]


def _has_pictures(folder: Path) -> bool:
    return folder.is_dir() and any(name.lower().endswith(PICTURE_SUFFIXES) for name in list_entries(folder))


def _make_camera(where: str, lenses: Mapping[int, Lens], images: Sequence[Photo], rig_size: float) -> Camera:
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


def _find_model(source: Path) -> Path | None:
    return next((source / each for each in MODEL_FOLDERS if model_suffix(list_entries(source / each))), None)
