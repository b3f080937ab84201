"""Neural 3D Video: poses_bounds.npy (LLFF) beside camNN.mp4.

Each row of the array contains a camera's 3 x 5 matrix and two depth bounds. The first three columns of the matrix are
the camera's axes down, right and backwards in world coordinates. The fourth column is the camera's position in the
world, and the fifth is (height, width, focal length) in pixels. The principal point is the centre of the image.
"""

from __future__ import annotations

import os
from pathlib import Path
from tokenize import TokenError

import numpy as np

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.limits import read_limited
from fourd.recording.importing.folders import Array, find_frames, make_camera, parse_numbers
from fourd.recording.importing.imported import Imported, ImportedCamera

NAME = "poses_bounds.npy"
COLUMNS = 17
MAGIC = b"\x93NUMPY"
PARSER_ERRORS = (
    OSError,
    ValueError,
    EOFError,
    SyntaxError,
    TokenError,
    OverflowError,
    TypeError,
    AttributeError,
    KeyError,
    MemoryError,
    RecursionError,
)
"""Errors that NumPy raises for a file with an invalid header, because it parses the header as a Python literal."""
MAX_PIXELS = 1 << 20
MAX_BYTES = 1 << 20
"""Maximum size of the file in bytes. Each camera takes 136 bytes."""


def looks_like(source: Path) -> bool:
    """Return whether ``source`` is a folder with poses_bounds.npy."""
    return os.path.isfile(source / NAME)


def read(source: Path) -> Imported:
    """Read the cameras of ``source``. Row i of the array in poses_bounds.npy belongs to video i, in the alphabetical
    order of the videos' names, as in LLFF's programs (cam10 before cam2).

    Raises:
        UserError: when the file does not contain an array of N x 17 numbers, or the numbers of videos and rows differ.
    """
    path = source / NAME
    rows = _rows(path)
    frames = dict(sorted(find_frames(source).items()))
    if len(frames) != len(rows):
        raise UserError(
            f"{path}: expected {len(frames)} rows, one for each video ({', '.join(frames)}), got {len(rows)}; "
            "restore the missing videos, or remove the rows without a video"
        )
    cameras = tuple(
        ImportedCamera(name, _make_camera(f"{path}: row {index}", row), found)
        for index, (row, (name, found)) in enumerate(zip(rows, frames.items(), strict=True))
    )
    notes = (
        "lengths are kept; the unit of length is unknown",
        "camera axes are converted from down, right, backwards to right, down, forward (OpenCV)",
        "rows belong to the videos in the alphabetical order of video names; near and far bounds are ignored",
    )
    return Imported(cameras, notes)


def _rows(path: Path) -> Array:
    try:
        # With memory mapping, a header that declares too large an array raises an error before memory is allocated.
        if read_limited(path, MAX_BYTES)[:6] != MAGIC:
            raise ValueError("another format")
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except PARSER_ERRORS as error:
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise UserError(f"{path}: expected a NumPy array, got '{reason}'; copy it again") from error
    if array.dtype.kind not in "fiu":
        raise UserError(f"{path}: expected real numbers, got {array.dtype}; write it again")
    return parse_numbers(str(path), array, (-1, COLUMNS))


def _make_camera(where: str, row: Array) -> Camera:
    matrix = row[:15].reshape(3, 5)
    down, right, backwards, centre, (height, width, focal) = matrix.T
    if not (1 <= width <= MAX_PIXELS and 1 <= height <= MAX_PIXELS):
        raise UserError(f"{where}: expected height and width in pixels, got {height:g} and {width:g}; copy it again")
    R_camera_world = np.stack([right, down, -backwards])
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return make_camera(where, intrinsics, R_camera_world, -R_camera_world @ centre, (width, height))
