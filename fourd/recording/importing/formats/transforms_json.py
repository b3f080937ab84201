"""transforms.json of nerfstudio and instant-ngp: camera-to-world poses (x right, y up, z backwards).

The first pixel's centre is (0.5, 0.5), as in fourd. The JSON has one entry per image. If the entries have no times,
every entry is a camera with one frame.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.recording.capture.decoding import picture_size
from fourd.recording.capture.layout import PICTURE_SUFFIXES, frame_name
from fourd.recording.importing.folders import Array, make_camera, parse_numbers, read_file
from fourd.recording.importing.imported import Imported, ImportedCamera, PictureFiles

NAME = "transforms.json"
LENS_MODELS = ("OPENCV", "PINHOLE", "FULL_OPENCV", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")
MATRICES = ("K", "intrinsics", "camera_intrinsics", "intrinsic_matrix")
"""Keys of matrices of intrinsics in pixels, which some programs write instead of focal lengths."""
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")
RATIONAL = ("k4", "k5", "k6")
OTHER_COEFFICIENTS = ("s1", "s2", "s3", "s4")
IGNORED = (
    "aabb_scale",
    "scale",
    "offset",
    "applied_transform",
    "applied_scale",
    "ply_file_path",
    "orientation_override",
)
MAX_PIXELS = 1 << 20


@dataclass(frozen=True, eq=False)
class _Entry:
    """One entry of the JSON: path in the JSON, image file, matte file, camera, and time, which may be None."""

    path: PurePosixPath
    picture: Path
    mask: Path | None
    camera: Camera
    time: float | None

    @property
    def key(self) -> tuple[float, ...]:
        """Key that is equal for two entries if their poses, intrinsics, distortion and image sizes are equal."""
        camera = self.camera
        parts = [camera.rotation, camera.translation, camera.intrinsics, np.array([camera.width, camera.height])]
        parts += [] if camera.distortion is None else [camera.distortion]
        return tuple(np.concatenate([part.ravel() for part in parts]).round(9).tolist())


def looks_like(source: Path) -> bool:
    """Return whether ``source`` is a folder with transforms.json, or a file transforms*.json."""
    return os.path.isfile(_json_path(source))


def read(source: Path) -> Imported:
    """Read the cameras of ``source``.

    If the entries have no times, each entry is a camera. If they have times, the entries of each folder form a camera,
    provided that no folder contains different poses or intrinsics, and that the folder names are unique and not empty.
    Otherwise, the entries with the same pose and intrinsics form a camera.

    Raises:
        UserError: when the JSON is invalid, a value is missing or invalid, a lens is a fisheye, a path is outside the
            folder or has no image, or a camera has two images at the same time.
    """
    path = _json_path(source)
    try:
        data = json.loads(read_file(path))
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: expected JSON, got '{error}'; export it again") from error
    entries = [_entry(path, values) for values in _list_entries(path, data)]
    timed = sum(entry.time is not None for entry in entries)
    if timed not in (0, len(entries)):
        raise UserError(
            f"{path}: expected a time in all {len(entries)} entries or in none, got a time in {timed}; "
            "add the missing times"
        )
    masked = sum(entry.mask is not None for entry in entries)
    times = sorted({entry.time or 0.0 for entry in entries})
    name_at = {time: frame_name(index) for index, time in enumerate(times)}
    cameras = []
    for name, group in (_by_camera(path, entries) if timed else _single(path, entries)).items():
        names = tuple(name_at[entry.time or 0.0] for entry in group)
        masks = tuple(entry.mask for entry in group if entry.mask is not None)
        mattes = PictureFiles(masks, names) if len(masks) == len(group) else None
        frames = PictureFiles(tuple(entry.picture for entry in group), names)
        cameras.append(ImportedCamera(name, group[0].camera, frames, mattes))
    notes = [
        "lengths are kept; the unit of length is unknown",
        "camera axes are converted from y up, z backwards to y down, z forward (OpenCV)",
    ]
    ignored = [key for key in IGNORED if key in data]
    notes += [f"ignored: {', '.join(ignored)}"] if ignored else []
    unmasked = [camera.name for camera in cameras if camera.masks is None]
    if unmasked and masked:
        notes.append(f"mattes of some cameras are not imported, because entries have none: {', '.join(unmasked)}")
    return Imported(tuple(cameras), tuple(notes))


def read_poses(path: Path, data: object) -> list[tuple[Camera, float | None]]:
    """Return the camera and the time of each entry of a transforms.json, in the order of the file. Images are read only
    to find sizes that the file does not state.

    Args:
        path: the file, for messages and for the places of images.
        data: its parsed content.

    Raises:
        UserError: like :func:`read`.
    """
    found: list[tuple[Camera, float | None]] = []
    for values in _list_entries(path, data):
        picture = path.parent
        if values.get("w") is None or values.get("h") is None:
            _, picture = _find_picture(path, f"{values.where}: file_path", values.entry.get("file_path"))
        time = None if values.entry.get("time") is None else values.number("time")
        found.append((_make_camera(values, picture), time))
    return found


def _list_entries(path: Path, data: object) -> list[_Values]:
    listed = data.get("frames") if isinstance(data, dict) else None
    if (
        not isinstance(data, dict)
        or not isinstance(listed, list)
        or not listed
        or not all(isinstance(entry, dict) for entry in listed)
    ):
        raise UserError(f"{path}: expected a list 'frames' of entries with poses, got none; export it again")
    return [_Values(f"{path}: entry {index}", entry, data) for index, entry in enumerate(listed)]


def _entry(path: Path, values: _Values) -> _Entry:
    relative, picture = _find_picture(path, f"{values.where}: file_path", values.entry.get("file_path"))
    mask = None
    if values.entry.get("mask_path") is not None:
        _, mask = _find_picture(path, f"{values.where}: mask_path", values.entry["mask_path"])
    time = None if values.entry.get("time") is None else values.number("time")
    return _Entry(relative, picture, mask, _make_camera(values, picture), time)


@dataclass(frozen=True)
class _Values:
    """The values of an entry, and the values of the whole file, which apply if the entry has none."""

    where: str
    entry: Mapping[str, object]
    whole: Mapping[str, object]

    def get(self, key: str) -> object:
        return self.whole.get(key) if self.entry.get(key) is None else self.entry[key]

    def number(self, key: str, default: float | None = None) -> float:
        if self.get(key) is None and default is not None:
            return default
        if self.get(key) is None:
            raise UserError(f"{self.where}: expected {key}, got none; export it again")
        return float(parse_numbers(f"{self.where}: {key}", self.get(key), ()))


def _make_camera(values: _Values, picture: Path) -> Camera:
    where = values.where
    model = values.get("camera_model") or "OPENCV"
    if model not in LENS_MODELS or values.get("is_fisheye"):
        raise UserError(
            f"{where}: camera_model: expected {', '.join(LENS_MODELS[:3])}, got "
            f"{model if model not in LENS_MODELS else 'a fisheye'}; undistort the images first"
        )
    if values.get("w") is None or values.get("h") is None:
        width, height = map(float, picture_size(picture))
    else:
        width, height = values.number("w"), values.number("h")
        if not (1 <= width <= MAX_PIXELS and 1 <= height <= MAX_PIXELS):
            raise UserError(f"{where}: w and h: expected pixels, got {width:g} x {height:g}; correct or remove them")
    matrix = values.get("transform_matrix")
    rows = 3 if isinstance(matrix, list) and len(matrix) == 3 else 4
    pose = parse_numbers(f"{where}: transform_matrix", matrix, (rows, 4))
    R_camera_world = np.diag([1.0, -1.0, -1.0]) @ pose[:3, :3].T
    translation = -R_camera_world @ pose[:3, 3]
    distortion = _distortion(values, rational=model == "FULL_OPENCV")
    return make_camera(
        where, _intrinsics(values, width, height), R_camera_world, translation, (width, height), distortion
    )


def _intrinsics(values: _Values, width: float, height: float) -> Array:
    """Return the intrinsics (3, 3) in pixels, from a matrix or from focal lengths. The values of the entry are
    preferred to those of the whole file.

    Raises:
        UserError: if the values are invalid, or a matrix and focal lengths at the same place differ.
    """
    for place in (values.entry, values.whole):
        key = next((key for key in MATRICES if place.get(key) is not None), None)
        has_focal = any(place.get(key) is not None for key in ("fl_x", "camera_angle_x"))
        if key is None and not has_focal:
            continue
        if key is None:
            return _from_focal(values, width, height)
        matrix = _matrix(f"{values.where}: {key}", place[key], width)
        if has_focal and not np.allclose(matrix, _from_focal(values, width, height), rtol=1e-3, atol=0.1):
            raise UserError(
                f"{values.where}: expected {key} and fl_x, fl_y, cx, cy to be the same, got different values; remove "
                "the wrong ones"
            )
        return matrix
    keys = f"fl_x, camera_angle_x, {', '.join(MATRICES[:-1])} or {MATRICES[-1]}"
    raise UserError(f"{values.where}: expected {keys}, got none of them; export it again")


def _matrix(where: str, value: object, width: float) -> Array:
    """Read intrinsics (3, 3) in pixels from a matrix of 3 or 4 rows and columns, or from a list of 9 or 16 numbers."""
    try:
        side = {9: 3, 12: 4, 16: 4}.get(np.size(np.array(value, np.float64)), 3)
    except (TypeError, ValueError, OverflowError):
        side = 3
    if isinstance(value, list) and len(value) in (9, 16):
        value = [value[start : start + side] for start in range(0, len(value), side)]
    rows = 3 if isinstance(value, list) and len(value) == 3 else side
    matrix = parse_numbers(where, value, (rows, side))[:3, :3].copy()
    if matrix[0, 2] <= 1 < width / 2:
        raise UserError(
            f"{where}: expected pixels, got a principal point at x = {matrix[0, 2]:g}; if the values are shares of the "
            "image size, multiply them by width and height, and export it again"
        )
    return matrix


def _from_focal(values: _Values, width: float, height: float) -> Array:
    focal_x = values.number("fl_x", _focal(values.number("camera_angle_x", 1.0), width))
    has_angle_y = values.get("camera_angle_y") is not None
    focal_y = values.number("fl_y", _focal(values.number("camera_angle_y"), height) if has_angle_y else focal_x)
    return np.array(
        [[focal_x, 0, values.number("cx", width / 2)], [0, focal_y, values.number("cy", height / 2)], [0, 0, 1]]
    )


def _distortion(values: _Values, rational: bool) -> Array:
    """Return OpenCV's distortion coefficients.

    In nerfstudio's model OPENCV, k3 and k4 are the coefficients of r^6 and r^8. OpenCV has the first one only. In
    COLMAP's model FULL_OPENCV, k4 to k6 are the coefficients of a denominator, as in OpenCV.

    Raises:
        UserError: if a coefficient that OpenCV does not have is not 0.
    """
    keys = (*COEFFICIENTS, *RATIONAL) if rational else COEFFICIENTS
    for key in OTHER_COEFFICIENTS if rational else (*RATIONAL, *OTHER_COEFFICIENTS):
        if values.number(key, 0.0) != 0:
            reason = "a term of r^8, which OpenCV's lens model lacks" if key == "k4" else "which is not supported"
            raise UserError(
                f"{values.where}: {key}: expected 0, got {values.number(key):g}, {reason}; undistort the images first"
            )
    return np.array([values.number(key, 0.0) for key in keys])


def _focal(angle: float, pixels: float) -> float:
    """Return the focal length in pixels for a field of view in radians, or 0 if the field of view is not in (0, pi)."""
    return pixels / 2 / math.tan(angle / 2) if 0 < angle < math.pi else 0.0


def _find_picture(path: Path, where: str, value: object) -> tuple[PurePosixPath, Path]:
    """Find the image file for a path from the JSON. Raises UserError if the path is outside the folder of the JSON."""
    if not isinstance(value, str) or not value or "\0" in value:
        raise UserError(f"{where}: expected an image's path, got '{value!r}'; export it again")
    relative = PurePosixPath(value.replace("\\", "/"))
    if relative.is_absolute() or ".." in relative.parts or not relative.parts or ":" in relative.parts[0]:
        raise UserError(f"{where}: expected a path within {path.parent}, got '{value}'; write a relative path")
    target = path.parent / relative
    for suffix in ("", *PICTURE_SUFFIXES):
        found = target.with_name(target.name + suffix)
        if found.suffix.lower() in PICTURE_SUFFIXES and os.path.isfile(found):
            return relative, found
    raise UserError(f"{where}: expected an image at {target}, got none; restore it or remove the entry")


def _single(path: Path, entries: list[_Entry]) -> dict[str, list[_Entry]]:
    """Make a camera of each entry.

    Each camera is named after its image file. If the file names are not unique, the cameras are named after the folders
    of the images. If the folder names are not unique either, the cameras are named after the paths of the images.
    """
    stems = [entry.path.name if entry.picture.name != entry.path.name else entry.path.stem for entry in entries]
    folders = [entry.path.parent.name for entry in entries]
    paths = ["_".join((*entry.path.parent.parts, stem)) for entry, stem in zip(entries, stems, strict=True)]
    for names in (stems, folders, paths):
        clean = [_clean(name) for name in names]
        if "" not in clean and len(set(clean)) == len(clean):
            return {name: [entry] for name, entry in zip(clean, entries, strict=True)}
    raise UserError(f"{path}: expected each image once, got the same image in two entries; remove one, or add times")


def _by_camera(path: Path, entries: list[_Entry]) -> dict[str, list[_Entry]]:
    """Group the entries by camera and sort each group by time."""
    folders: dict[str, list[_Entry]] = {}
    poses: dict[tuple[float, ...], list[_Entry]] = {}
    for entry in entries:
        folders.setdefault(entry.path.parent.as_posix(), []).append(entry)
        poses.setdefault(entry.key, []).append(entry)
    names = [_clean(PurePosixPath(folder).name) for folder in folders]
    is_static = all(len({entry.key for entry in group}) == 1 for group in folders.values())
    if is_static and "" not in names and len(set(names)) == len(names):
        cameras = dict(zip(names, folders.values(), strict=True))
    else:
        cameras = {f"{index:02d}": group for index, group in enumerate(poses.values())}
    for name, group in cameras.items():
        group.sort(key=lambda entry: entry.time or 0.0)
        times = [entry.time for entry in group]
        if len(set(times)) != len(times):
            raise UserError(
                f"{path}: expected static cameras with each time once, got {len(set(times))} different times in "
                f"{len(times)} images of '{name}'; remove the entries that repeat a time"
            )
    return cameras


def _clean(name: str) -> str:
    """Replace the characters of ``name`` other than letters, digits, ``_``, ``-`` and ``.``."""
    return re.sub(r"[^\w.-]", "_", name).lstrip(".-")


def _json_path(source: Path) -> Path:
    if source.name.startswith("transforms") and source.suffix == ".json":
        return source
    return source / NAME
