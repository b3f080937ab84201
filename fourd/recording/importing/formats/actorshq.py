"""ActorsHQ: calibration.csv beside rgbs/CAM/CAM_rgb000000.jpg and masks/CAM/CAM_mask000000.png.

Each row of the CSV contains the camera-to-world pose (OpenCV axes) as a rotation vector and a position in metres. Focal
lengths and principal points are in units of the image's width and height. The origin of image coordinates is the corner
of the first pixel, as in fourd.
"""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.recording.importing.folders import (
    find_frames,
    join_calibrations,
    make_camera,
    parse_numbers,
    read_file,
    read_head,
)
from fourd.recording.importing.imported import Imported

NAME = "calibration.csv"
COLUMNS = ("name", "w", "h", "rx", "ry", "rz", "tx", "ty", "tz", "fx", "fy", "px", "py")
MAX_PIXELS = 1 << 20


def looks_like(source: Path) -> bool:
    """Return whether ``source`` is a folder with ActorsHQ's calibration.csv."""
    return read_head(source / NAME, 64).lstrip(b"\xef\xbb\xbf").startswith(b"name,w,h,rx,")


def read(source: Path) -> Imported:
    """Read the cameras of ``source``. Lengths are in metres.

    Raises:
        UserError: when the CSV lacks a column or a number, names a camera twice, or names none of the cameras in rgbs/.
    """
    path = source / NAME
    calibrations = read_cameras(path)
    frames = find_frames(source, ("rgbs",))
    cameras, notes = join_calibrations(frames, calibrations, path, [source / "masks"])
    return Imported(
        cameras, ("metres and axes are kept; poses are inverted from camera-to-world to world-to-camera", *notes)
    )


def read_cameras(path: Path) -> dict[str, Camera]:
    """Read a calibration.csv. Returns the cameras, in metres, keyed by name. Raises UserError if the CSV lacks a column
    or a number, or names a camera twice."""
    try:
        rows = list(csv.DictReader(read_file(path).decode("utf-8-sig").splitlines(), strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"{path}: expected ActorsHQ's CSV, got '{error}'; copy it again") from error
    missing = [column for column in COLUMNS if not rows or column not in rows[0]]
    if missing:
        raise UserError(f"{path}: expected rows with {','.join(COLUMNS)}, got no {missing[0]}; copy the file again")
    cameras: dict[str, Camera] = {}
    for line, row in enumerate(rows, start=2):
        name = row["name"]
        if not name or name in cameras:
            raise UserError(f"{path}: line {line}: expected a unique camera name, got '{name}'; remove the duplicate")
        cameras[name] = _make_camera(f"{path}: camera '{name}'", row)
    return cameras


def _make_camera(where: str, row: dict[str, str]) -> Camera:
    values = {column: float(parse_numbers(f"{where}: {column}", row[column], ())) for column in COLUMNS[1:]}
    width, height = values["w"], values["h"]
    if not (1 <= width <= MAX_PIXELS and 1 <= height <= MAX_PIXELS):
        raise UserError(f"{where}: expected w and h in pixels, got {width:g} x {height:g}; copy the file again")
    intrinsics = np.array(
        [[width * values["fx"], 0, width * values["px"]], [0, height * values["fy"], height * values["py"]], [0, 0, 1]]
    )
    R_world_camera = np.asarray(cv2.Rodrigues(np.array([values["rx"], values["ry"], values["rz"]]))[0], np.float64)
    centre = np.array([values["tx"], values["ty"], values["tz"]])
    return make_camera(where, intrinsics, R_world_camera.T, -R_world_camera.T @ centre, (width, height))
