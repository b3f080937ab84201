"""Caliscope: camera_array.toml, with one table [cameras.N] per camera, beside the videos cam_N.

Poses are world-to-camera, in metres, with OpenCV's axes. Caliscope calibrates with OpenCV, in which the origin of pixel
coordinates is the centre of the first pixel. In fourd, the origin is the corner of the first pixel, so half a pixel is
added to the principal points.
"""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.recording.importing.folders import find_frames, join_calibrations, list_entries, parse_numbers, read_head
from fourd.recording.importing.imported import Imported
from fourd.recording.importing.readers.opencv_toml import camera_of_table, read_toml

NAME = "camera_array.toml"
HEAD_BYTES = 1 << 18
INTRINSIC_KEYS = ("size", "matrix", "distortions")
POSE_KEYS = ("rotation", "translation")


def looks_like(source: Path) -> bool:
    """Return whether ``source`` is a camera_array.toml, or a folder with one."""
    return is_calibration(_path(source))


def is_calibration(path: Path) -> bool:
    """Return whether ``path`` is a TOML with Caliscope's tables [cameras.N]."""
    if path.suffix.lower() != ".toml":
        return False
    head = read_head(path, HEAD_BYTES)
    return re.search(rb"(?m)^\s*\[cameras\.[^\]]+\]", head) is not None and b"matrix" in head


def read_names(path: Path) -> list[str]:
    """Return the names of the cameras of a calibration file. Raises UserError if the file is invalid."""
    return list(read_cameras(path)[0])


def read(source: Path, frames: Path | None = None) -> Imported:
    """Read the cameras of ``source``: a folder with camera_array.toml, or the TOML itself.

    Args:
        source: the folder or the TOML.
        frames: folder that contains the cameras' videos, or None for the folder of the TOML.

    Raises:
        UserError: when the TOML is invalid, a value is missing or invalid, a camera has intrinsics but no pose, a lens
            is a fisheye, or no camera in the TOML has a video.
    """
    path = _path(source)
    calibrations, notes = read_cameras(path)
    cameras, more = join_calibrations(find_frames(frames or path.parent, names=list(calibrations)), calibrations, path)
    return Imported(cameras, (*notes, *more))


def read_cameras(path: Path) -> tuple[dict[str, Camera], list[str]]:
    """Read a camera_array.toml. Returns two values: the cameras, keyed by the names cam_N, and a list of notes for the
    user. Cameras that Caliscope ignores are left out.

    Raises:
        UserError: if the TOML is invalid, if it contains no camera or the same camera twice, or if a camera has a
            missing or invalid value, has intrinsics but no pose, or has a fisheye lens.
    """
    data = read_toml(path)
    tables = data.get("cameras")
    cameras: dict[str, Camera] = {}
    ignored = []
    for key, table in tables.items() if isinstance(tables, dict) else ():
        where = f"{path}: [cameras.{key}]"
        if not isinstance(table, dict):
            raise UserError(f"{where}: expected a table, got a value; calibrate again")
        name = f"cam_{table.get('cam_id', table.get('port', key))}"
        if table.get("ignore", False):
            ignored.append(name)
            continue
        if name in cameras:
            raise UserError(f"{where}: expected each camera once, got {name} twice; calibrate again")
        cameras[name] = _make_camera(where, table)
    if not cameras:
        raise UserError(f"{path}: expected a table [cameras.N] for each camera, got none; calibrate again")
    notes = [
        "lengths are kept: Caliscope's unit is the metre",
        "half a pixel is added to the principal points, because the origin was the first pixel's centre",
    ]
    notes += [f"cameras that Caliscope ignores, not imported: {', '.join(ignored)}"] if ignored else []
    return cameras, notes


def _make_camera(where: str, table: dict[str, object]) -> Camera:
    if any(table.get(key) is None for key in POSE_KEYS):
        raise UserError(f"{where}: expected rotation and translation, got only intrinsics; calibrate the poses")
    missing = [key for key in INTRINSIC_KEYS if table.get(key) is None]
    if missing:
        raise UserError(f"{where}: expected {', '.join(INTRINSIC_KEYS)}, got no {missing[0]}; calibrate again")
    values = table["rotation"]
    if isinstance(values, list) and values and not isinstance(values[0], list):
        rotation = np.asarray(cv2.Rodrigues(parse_numbers(f"{where}: rotation", values, (3,)))[0], np.float64)
    else:
        rotation = parse_numbers(f"{where}: rotation", values, (3, 3))
    translation = parse_numbers(f"{where}: translation", table["translation"], (3,))
    return camera_of_table(where, table, rotation, translation)


def _path(source: Path) -> Path:
    return source / NAME if NAME in list_entries(source) else source
