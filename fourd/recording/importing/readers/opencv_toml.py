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

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.recording.importing.folders import make_camera, parse_numbers, read_file

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
    distortion = _distortion(f"{where}: distortions", table["distortions"])
    return make_camera(where, intrinsics, rotation, translation, (width, height), distortion)


def _distortion(where: str, value: object) -> Array:
    """Read distortion coefficients in OpenCV's order. The list may be inside another list, as NumPy writes a matrix of
    one row. Missing coefficients are 0."""
    if isinstance(value, list) and len(value) == 1 and isinstance(value[0], list):
        value = value[0]
    coefficients = parse_numbers(where, value, (-1,))
    if len(coefficients) == 3 and coefficients[2] != 0:
        raise UserError(
            f"{where}: expected 4 or 5 numbers, got {coefficients.tolist()}, in which the third one may be p1 or k3; "
            "write k1, k2, p1, p2, k3"
        )
    return coefficients if len(coefficients) > 3 else np.pad(coefficients, (0, 5 - len(coefficients)))
