"""The cameras and the images of a COLMAP model, as text or binary files.

Only cameras.* and images.* are read. They contain the poses of all images, also in models with rigs (rigs.*, frames.*),
and pycolmap, which reads all files of a model, neither reads a model without points3D.* nor names with spaces in text
files. The files are read as streams, because images.* also contains the points of all images.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from scipy.spatial.transform import Rotation

from fourd.base.errors import UserError
from fourd.base.limits import open_regular, printable
from fourd.recording.importing.folders import Array, parse_numbers

LENSES = {
    0: ("SIMPLE_PINHOLE", 3),
    1: ("PINHOLE", 4),
    2: ("SIMPLE_RADIAL", 4),
    3: ("RADIAL", 5),
    4: ("OPENCV", 8),
    5: ("OPENCV_FISHEYE", 8),
    6: ("FULL_OPENCV", 12),
    7: ("FOV", 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 4),
    9: ("RADIAL_FISHEYE", 5),
    10: ("THIN_PRISM_FISHEYE", 12),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 16),
    12: ("SIMPLE_DIVISION", 4),
    13: ("DIVISION", 5),
    14: ("SIMPLE_FISHEYE", 3),
    15: ("FISHEYE", 4),
    16: ("EUCM", 6),
    17: ("EQUIRECTANGULAR", 2),
}
"""Name and number of parameters of each lens model, keyed by the model's number in cameras.bin."""
MAX_LINE_BYTES = 1 << 28
"""Maximum length of a line in images.txt. A line contains all points of an image."""
MAX_CHECKED_BYTES = 4096
MAX_NAME_BYTES = 4096
MAX_IMAGES = 1_000_000
MAX_SHOWN = 80
"""Maximum number of characters of a wrong line that an error message quotes."""
MAX_PARAMETERS = 64
POINT_BYTES = 24


@dataclass(frozen=True, eq=False)
class Lens:
    """A camera of the COLMAP model: the lens model's name, the image size in pixels, and the parameters in COLMAP's
    order."""

    kind: str
    width: int
    height: int
    parameters: Array


@dataclass(frozen=True, eq=False)
class Photo:
    """An image of the COLMAP model: its name, the number of its camera, and the world-to-camera matrix (3, 4)."""

    name: str
    lens: int
    pose: Array


def model_suffix(names: Iterable[str]) -> str | None:
    """Return the suffix of the model's files, ``.bin`` or ``.txt``, for the names of the files in a folder. Returns
    None if the folder has no model. Like COLMAP, prefer the binary model."""
    found = set(names)
    return next((suffix for suffix in (".bin", ".txt") if {f"cameras{suffix}", f"images{suffix}"} <= found), None)


def read_model(folder: Path) -> tuple[dict[int, Lens], list[Photo]]:
    """Read the lenses, keyed by camera number, and the registered images in the order of their names.

    Raises:
        UserError: when a file is damaged, or an image has a camera that is not in the model.
    """
    suffix = model_suffix(os.listdir(folder)) or ".bin"
    cameras, images = folder / f"cameras{suffix}", folder / f"images{suffix}"
    try:
        if suffix == ".txt":
            lenses, found = _read_text_lenses(cameras), _read_text_photos(images)
        else:
            lenses, found = _read_binary_lenses(cameras), _read_binary_photos(images)
        photos = list(islice(found, MAX_IMAGES + 1))
    except UnicodeDecodeError as error:
        raise UserError(f"{folder}: expected image names in UTF-8, got other bytes; rename the image") from error
    except OSError as error:
        raise UserError(f"{folder}: expected a COLMAP model, got '{error.strerror}'; copy it again") from error
    if len(photos) > MAX_IMAGES:
        raise UserError(f"{images}: expected at most {MAX_IMAGES} images, got more; import fewer cameras or frames")
    missing = next((photo for photo in photos if photo.lens not in lenses), None)
    if missing is not None:
        raise UserError(
            f"{images}: image '{missing.name}': expected a camera of {cameras.name}, got camera {missing.lens}; "
            "reconstruct the model again"
        )
    return lenses, sorted(photos, key=lambda photo: photo.name)


def _read_text_lenses(path: Path) -> dict[int, Lens]:
    lenses = {}
    for number, line in _lines(path):
        words = line.split()
        try:
            identifier, kind, width, height = int(words[0]), words[1], int(words[2]), int(words[3])
        except (ValueError, IndexError) as error:
            raise _wrong_line(path, number, "CAMERA_ID MODEL WIDTH HEIGHT PARAMS", line) from error
        values = _numbers(path, number, line, words[4:])
        wanted = next((count for name, count in LENSES.values() if name == kind), len(values))
        if len(values) != wanted:
            raise _wrong_line(path, number, f"{wanted} parameters of the lens model {kind}", line)
        lenses[identifier] = Lens(kind, width, height, values)
    return lenses


def _read_text_photos(path: Path) -> Iterator[Photo]:
    lines = _lines(path, with_points=True)
    for number, line in lines:
        # The name is the rest of the line, because it may contain spaces.
        words = line.split(maxsplit=9)
        try:
            lens, name = int(words[8]), words[9]
            int(words[0])
        except (ValueError, IndexError) as error:
            raise _wrong_line(path, number, "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME", line) from error
        values = _numbers(path, number, line, words[1:8])
        yield Photo(name, lens, _pose(f"{path}: line {number}", values))


def _lines(path: Path, *, with_points: bool = False) -> Iterator[tuple[int, str]]:
    """Yield the lines of a text file with their numbers. Empty lines and comments are left out. If ``with_points``,
    each yielded line is followed by a line of points, which may be empty, and which is left out too."""
    with open_regular(path) as file:
        number = 0
        while content := file.readline(MAX_LINE_BYTES):
            number += 1
            line = content.decode("utf-8-sig" if number == 1 else "utf-8").strip()
            if line and not line.startswith("#"):
                yield number, line
                if with_points:
                    number += 1
                    _check_points(path, number, file.readline(MAX_LINE_BYTES))


def _check_points(path: Path, number: int, line: bytes) -> None:
    """Raise UserError for a short line that cannot contain points. Some programs write only the lines of the images, so
    that every second image would be taken for points."""
    if len(line) < MAX_CHECKED_BYTES and len(line.split()) % 3:
        raise _wrong_line(
            path, number, "points (X Y POINT3D_ID) or an empty line", line.decode("utf-8", "replace").strip()
        )


def _numbers(path: Path, number: int, line: str, words: list[str]) -> Array:
    try:
        values = [float(word) for word in words[:MAX_PARAMETERS]]
    except ValueError as error:
        raise _wrong_line(path, number, "numbers with a decimal point", line) from error
    return parse_numbers(f"{path}: line {number}", values, (-1,))


def _wrong_line(path: Path, number: int, expected: str, line: str) -> UserError:
    got = printable(line[:MAX_SHOWN])
    return UserError(f"{path}: line {number}: expected {expected}, got '{got}'; export the model from COLMAP again")


def _read_binary_lenses(path: Path) -> dict[int, Lens]:
    lenses = {}
    with open_regular(path) as file:
        (count,) = _unpack(path, file, "<Q")
        for _ in range(count):
            identifier, kind, width, height = _unpack(path, file, "<IiQQ")
            if kind not in LENSES:
                raise UserError(
                    f"{path}: camera {identifier}: expected a lens model among {', '.join(_names())}, got number "
                    f"{kind}; undistort the images with COLMAP, or reconstruct with OPENCV"
                )
            name, size = LENSES[kind]
            values = parse_numbers(f"{path}: camera {identifier}", _unpack(path, file, f"<{size}d"), (size,))
            lenses[int(identifier)] = Lens(name, int(width), int(height), values)
    return lenses


def _read_binary_photos(path: Path) -> Iterator[Photo]:
    size = path.stat().st_size
    with open_regular(path) as file:
        (count,) = _unpack(path, file, "<Q")
        for _ in range(count):
            identifier, *pose, lens = _unpack(path, file, "<I7dI")
            name = bytearray()
            while (byte := file.read(1)) != b"\0":
                if not byte or len(name) >= MAX_NAME_BYTES:
                    raise _truncated(path)
                name += byte
            (points,) = _unpack(path, file, "<Q")
            if file.tell() + POINT_BYTES * points > size:
                raise _truncated(path)
            file.seek(POINT_BYTES * points, os.SEEK_CUR)
            values = parse_numbers(f"{path}: image {identifier}", pose, (7,))
            yield Photo(name.decode(), int(lens), _pose(f"{path}: image {identifier}", values))


def _unpack(path: Path, file: BinaryIO, layout: str) -> tuple[Any, ...]:
    content = file.read(struct.calcsize(layout))
    if len(content) < struct.calcsize(layout):
        raise _truncated(path)
    return struct.unpack(layout, content)


def _truncated(path: Path) -> UserError:
    return UserError(f"{path}: expected a whole file, got a truncated one; copy it again")


def _names() -> list[str]:
    return [name for name, _ in LENSES.values()]


def _pose(where: str, values: Array) -> Array:
    """Return the world-to-camera matrix (3, 4) for a quaternion (w, x, y, z) and a translation."""
    if not np.linalg.norm(values[:4]) > 0:
        raise UserError(f"{where}: expected a rotation, got a quaternion of zeros; reconstruct the model again")
    rotation = Rotation.from_quat(np.roll(values[:4], -1)).as_matrix()
    return np.hstack([rotation, values[4:, None]])
