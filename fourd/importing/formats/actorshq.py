"""ActorsHQ: calibration.csv beside rgbs/CAM/CAM_rgb000000.jpg and masks/CAM/CAM_mask000000.png.

A row is a pose from the camera (OpenCV axes) to the world, as a rotation vector and metres. Focal lengths and
centres are in widths and heights of the picture, so pixels count from the first one's corner, as here.
"""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np

from fourd.cameras import Camera
from fourd.errors import UserError
from fourd.importing.formats.folders import first_bytes, frames_in, lens, numbers, whole_file, with_lenses
from fourd.importing.formats.imported import Imported

NAME = "calibration.csv"
COLUMNS = ("name", "w", "h", "rx", "ry", "rz", "tx", "ty", "tz", "fx", "fy", "px", "py")
MOST_PIXELS = 1 << 20


def looks_like(source: Path) -> bool:
    """Whether ``source`` is a folder with ActorsHQ's calibration.csv."""
    return first_bytes(source / NAME, 64).lstrip(b"\xef\xbb\xbf").startswith(b"name,w,h,rx,")


def read(source: Path) -> Imported:
    """Cameras of ``source``, in metres.

    Raises:
        UserError: when the CSV lacks a column or a number, names a camera twice, or cameras do not match.
    """
    path = source / NAME
    lenses = read_lenses(path)
    frames = frames_in(source, ("rgbs",))
    cameras, notes = with_lenses(frames, lenses, path, [source / "masks"])
    return Imported(cameras, ("metres, axes kept; poses turned from camera-to-world to world-to-camera", *notes))


def read_lenses(path: Path) -> dict[str, Camera]:
    """The cameras of a calibration.csv by name, in metres. Raises UserError as read."""
    try:
        rows = list(csv.DictReader(whole_file(path).decode("utf-8-sig").splitlines(), strict=True))
    except (UnicodeDecodeError, csv.Error) as error:
        raise UserError(f"{path}: expected ActorsHQ's CSV, got '{error}'; copy it again") from error
    missing = [column for column in COLUMNS if not rows or column not in rows[0]]
    if missing:
        raise UserError(f"{path}: expected rows with {','.join(COLUMNS)}, got none of {missing[0]}; copy it again")
    lenses: dict[str, Camera] = {}
    for line, row in enumerate(rows, start=2):
        name = row["name"]
        if not name or name in lenses:
            raise UserError(f"{path}: line {line}: expected each camera's own name, got '{name}'; drop the double")
        lenses[name] = _lens(f"{path}: camera '{name}'", row)
    return lenses


def _lens(where: str, row: dict[str, str]) -> Camera:
    values = {column: float(numbers(f"{where}: {column}", row[column], ())) for column in COLUMNS[1:]}
    width, height = values["w"], values["h"]
    if not (1 <= width <= MOST_PIXELS and 1 <= height <= MOST_PIXELS):
        raise UserError(f"{where}: expected w and h in pixels, got {width:g} x {height:g}; copy the file again")
    intrinsics = np.array(
        [[width * values["fx"], 0, width * values["px"]], [0, height * values["fy"], height * values["py"]], [0, 0, 1]]
    )
    R_world_camera = np.asarray(cv2.Rodrigues(np.array([values["rx"], values["ry"], values["rz"]]))[0], np.float64)
    centre = np.array([values["tx"], values["ty"], values["tz"]])
    return lens(where, intrinsics, R_world_camera.T, -R_world_camera.T @ centre, (width, height))
