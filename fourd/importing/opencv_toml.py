"""Tables of cameras in TOML files of programs that calibrate with OpenCV: Anipose, Pose2Sim, FreeMoCap and Caliscope.

In OpenCV, the origin of pixel coordinates is the centre of the first pixel. In fourd, the origin is the corner of the
first pixel, so half a pixel is added to the principal points.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera
from fourd.errors import UserError
from fourd.importing.folders import make_camera, parse_numbers, read_file

MAX_PIXELS = 1 << 20

Array = NDArray[np.float64]


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file. Raises UserError if the file is not valid TOML."""
    try:
        return tomllib.loads(read_file(path).decode())
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: expected TOML, got '{error}'; calibrate again") from error


def camera_of_table(where: str, table: Mapping[str, Any], rotation: Array, translation: Array) -> Camera:
    """Make a camera with the given pose. The camera's lens is read from the keys ``size``, ``matrix`` and
    ``distortions`` of ``table``.

    Args:
        where: file and table for error messages.
        table: the table.
        rotation: (3, 3) rotation from world to camera.
        translation: (3,) translation from world to camera.

    Raises:
        UserError: if a value is invalid, or the lens is a fisheye.
    """
    if table.get("fisheye", False):
        raise UserError(f"{where}: expected a lens without fisheye, got fisheye = true; undistort the videos first")
    width, height = (float(side) for side in parse_numbers(f"{where}: size", table["size"], (2,)))
    if not (1 <= width <= MAX_PIXELS and 1 <= height <= MAX_PIXELS):
        raise UserError(f"{where}: size: expected width and height in pixels, got {width:g} x {height:g}; correct it")
    intrinsics = parse_numbers(f"{where}: matrix", table["matrix"], (3, 3))
    intrinsics[:2, 2] += 0.5
    distortion = parse_numbers(f"{where}: distortions", table["distortions"], (-1,))
    return make_camera(where, intrinsics, rotation, translation, (width, height), distortion)
