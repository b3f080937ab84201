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

from fourd.cameras import Camera
from fourd.capture.decoding import picture_size
from fourd.capture.layout import PICTURE_SUFFIXES
from fourd.errors import UserError
from fourd.importing.folders import make_camera, parse_numbers, read_file
from fourd.importing.imported import Imported, ImportedCamera, PictureFiles

NAME = "transforms.json"
LENS_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "PERSPECTIVE")
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
            folder or has no image, or a camera lacks an image at a time at which another camera has one.
    """
    path = _json_path(source)
    try:
        data = json.loads(read_file(path))
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: expected JSON, got '{error}'; export it again") from error
    listed = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(listed, list) or not listed or not all(isinstance(entry, dict) for entry in listed):
        raise UserError(f"{path}: expected a list 'frames' of entries with poses, got none; export it again")
    entries = [_entry(path, index, {**data, **entry}) for index, entry in enumerate(listed)]
    timed = sum(entry.time is not None for entry in entries)
    if timed not in (0, len(entries)):
        raise UserError(
            f"{path}: expected a time in all {len(entries)} entries or in none, got a time in {timed}; "
            "add the missing times"
        )
    masked = sum(entry.mask is not None for entry in entries)
    cameras = []
    for name, group in (_by_camera(path, entries) if timed else _single(path, entries)).items():
        masks = tuple(entry.mask for entry in group if entry.mask is not None)
        mattes = PictureFiles(masks) if masked == len(entries) else None
        frames = PictureFiles(tuple(entry.picture for entry in group))
        cameras.append(ImportedCamera(name, group[0].camera, frames, mattes))
    notes = [
        "lengths are kept; the unit of length is unknown",
        "camera axes are converted from y up, z backwards to y down, z forward (OpenCV)",
    ]
    ignored = [key for key in IGNORED if key in data]
    notes += [f"ignored: {', '.join(ignored)}"] if ignored else []
    if 0 < masked < len(entries):
        notes.append(f"mattes are not imported, because only {masked} of {len(entries)} entries have a matte")
    return Imported(tuple(cameras), tuple(notes))


def _entry(path: Path, index: int, values: Mapping[str, object]) -> _Entry:
    """Make an entry from ``values``: the entry's own values, merged with the values of the whole file."""
    where = f"{path}: entry {index}"
    relative, picture = _find_picture(path, f"{where}: file_path", values.get("file_path"))
    mask = None
    if values.get("mask_path") is not None:
        _, mask = _find_picture(path, f"{where}: mask_path", values["mask_path"])
    time = None if values.get("time") is None else float(parse_numbers(f"{where}: time", values["time"], ()))
    return _Entry(relative, picture, mask, _make_camera(where, values, picture), time)


def _make_camera(where: str, values: Mapping[str, object], picture: Path) -> Camera:
    model = values.get("camera_model", "OPENCV")
    fisheye = values.get("is_fisheye") or values.get("k4")
    if model not in LENS_MODELS or fisheye:
        raise UserError(
            f"{where}: camera_model: expected {', '.join(LENS_MODELS[:3])}, got {'a fisheye' if fisheye else model}; "
            "undistort the images first"
        )

    def value(key: str, default: float | None = None) -> float:
        if values.get(key) is None and default is not None:
            return default
        if values.get(key) is None:
            raise UserError(f"{where}: expected {key}, got none; export it again")
        return float(parse_numbers(f"{where}: {key}", values[key], ()))

    if values.get("w") is None or values.get("h") is None:
        width, height = map(float, picture_size(picture))
    else:
        width, height = value("w"), value("h")
        if not (1 <= width <= MAX_PIXELS and 1 <= height <= MAX_PIXELS):
            raise UserError(f"{where}: w and h: expected pixels, got {width:g} x {height:g}; correct or remove them")
    if values.get("fl_x") is None and values.get("camera_angle_x") is None:
        raise UserError(f"{where}: expected fl_x or camera_angle_x, got neither; export it again")
    focal_x = value("fl_x", _focal(value("camera_angle_x", 1.0), width))
    angle_y = values.get("camera_angle_y")
    focal_y = value("fl_y", focal_x if angle_y is None else _focal(value("camera_angle_y"), height))
    principal = value("cx", width / 2), value("cy", height / 2)
    intrinsics = np.array([[focal_x, 0, principal[0]], [0, focal_y, principal[1]], [0, 0, 1]])
    distortion = np.array([value(key, 0.0) for key in ("k1", "k2", "p1", "p2", "k3")])
    matrix = values.get("transform_matrix")
    rows = 3 if isinstance(matrix, list) and len(matrix) == 3 else 4
    pose = parse_numbers(f"{where}: transform_matrix", matrix, (rows, 4))
    R_camera_world = np.diag([1.0, -1.0, -1.0]) @ pose[:3, :3].T
    return make_camera(where, intrinsics, R_camera_world, -R_camera_world @ pose[:3, 3], (width, height), distortion)


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
    raise UserError(f"{where}: expected a JPEG or PNG at {target}, got none; restore it or remove the entry")


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
    first = next(iter(cameras))
    for name, group in cameras.items():
        group.sort(key=lambda entry: entry.time or 0.0)
        times = [entry.time for entry in group]
        if len(set(times)) != len(times) or times != [entry.time for entry in cameras[first]]:
            raise UserError(
                f"{path}: expected static cameras with the same times, each time once, got {len(set(times))} different "
                f"times in {len(times)} images of '{name}' and {len(cameras[first])} images of '{first}'; "
                "remove the entries at times that other cameras lack"
            )
    return cameras


def _clean(name: str) -> str:
    """Replace the characters of ``name`` that a camera name must not contain."""
    return re.sub(r"[^A-Za-z0-9_.-]", "_", name).lstrip(".-")


def _json_path(source: Path) -> Path:
    if source.name.startswith("transforms") and source.suffix == ".json":
        return source
    return source / NAME
