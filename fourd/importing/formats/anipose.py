"""Anipose and Pose2Sim: a calibration TOML beside the videos, a table for each camera, world-to-camera.

Both calibrate by OpenCV, which counts pixels from the first one's centre: half a pixel is added to the centres.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import cv2
import numpy as np

from fourd.cameras import Camera
from fourd.errors import UserError
from fourd.importing.formats.folders import entries, first_bytes, frames_in, lens, numbers, whole_file, with_lenses
from fourd.importing.formats.imported import Imported

KEYS = ("name", "size", "matrix", "distortions", "rotation", "translation")
FIRST_TABLE = 4096
"""Bytes within which a calibration's first camera ends."""
MILLIMETRE = 1e-3
FARTHEST_METRES = 100.0
"""Cameras whose median distance is larger are in millimetres."""
MOST_PIXELS = 1 << 20


def looks_like(source: Path) -> bool:
    """Whether ``source`` is such a file, or a folder with one."""
    return bool(_files(source))


def read(source: Path) -> Imported:
    """Cameras of ``source``, a folder with the TOML and videos, or that file among the videos.

    Raises:
        UserError: when there is no such TOML or several, it does not parse, a value is missing or no number, a
            lens is a fisheye, or cameras and videos do not match.
    """
    files = _files(source)
    if len(files) != 1:
        got = " and ".join(path.name for path in files) or "none"
        raise UserError(f"{source}: expected one TOML with the cameras' calibration, got {got}; name the file itself")
    path = files[0]
    lenses, notes = read_lenses(path)
    cameras, more = with_lenses(frames_in(path.parent), lenses, path)
    return Imported(cameras, (*notes, *more))


def read_lenses(path: Path) -> tuple[dict[str, Camera], list[str]]:
    """The cameras of a calibration TOML by name, and notes. Raises UserError as read."""
    try:
        data = tomllib.loads(whole_file(path).decode())
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: expected TOML, got '{error}'; calibrate again") from error
    lenses: dict[str, Camera] = {}
    for key, table in data.items():
        if key == "metadata" or not isinstance(table, dict):
            continue
        where = f"{path}: [{key}]"
        missing = [wanted for wanted in KEYS if wanted not in table]
        if missing:
            raise UserError(f"{where}: expected {', '.join(KEYS)}, got no {missing[0]}; calibrate again")
        name = table["name"]
        if not isinstance(name, str) or not name or name in lenses:
            raise UserError(f"{where}: expected each camera's own name, got '{name}'; rename one")
        if table.get("fisheye", False):
            raise UserError(f"{where}: expected a lens without fisheye, got fisheye = true; undistort the videos first")
        lenses[name] = _lens(where, table)
    if not lenses:
        raise UserError(f"{path}: expected a table for each camera, got none; calibrate again")
    scale, unit = _unit(list(lenses.values()))
    lenses = {name: _scaled(camera, scale) for name, camera in lenses.items()}
    notes = [unit, "pixel centres at whole numbers -> half a pixel added to the centres"]
    metadata = data.get("metadata")
    if isinstance(metadata, dict):
        said = [f"{key} {metadata[key]}" for key in ("adjusted", "error") if isinstance(metadata.get(key), int | float)]
        notes += [f"the file says of the calibration: {', '.join(said)}"] if said else []
    return lenses, notes


def _lens(where: str, table: dict[str, object]) -> Camera:
    width, height = (float(pixels) for pixels in numbers(f"{where}: size", table["size"], (2,)))
    if not (1 <= width <= MOST_PIXELS and 1 <= height <= MOST_PIXELS):
        raise UserError(f"{where}: size: expected width and height in pixels, got {width:g} x {height:g}; mend it")
    intrinsics = numbers(f"{where}: matrix", table["matrix"], (3, 3))
    intrinsics[:2, 2] += 0.5
    vector = numbers(f"{where}: rotation", table["rotation"], (3,))
    rotation = np.asarray(cv2.Rodrigues(vector)[0], np.float64)
    translation = numbers(f"{where}: translation", table["translation"], (3,))
    distortion = numbers(f"{where}: distortions", table["distortions"], (-1,))
    return lens(where, intrinsics, rotation, translation, (width, height), distortion)


def _unit(cameras: list[Camera]) -> tuple[float, str]:
    """Metres in a unit of the file, judged by how far apart cameras stand, and what to say of it."""
    centres = np.stack([camera.centre for camera in cameras])
    distances = np.linalg.norm(centres[:, None] - centres[None], axis=2)[np.triu_indices(len(centres), 1)]
    if not len(distances):
        return 1.0, "lengths kept: one camera does not tell its unit"
    median = float(np.median(distances))
    if median > FARTHEST_METRES:
        return MILLIMETRE, f"taken for millimetres, since cameras stand {median:.0f} apart: millimetres -> metres"
    return 1.0, f"taken for metres, since cameras stand {median:.3g} apart: lengths kept"


def _scaled(camera: Camera, scale: float) -> Camera:
    size = (camera.width, camera.height)
    return Camera(camera.intrinsics, camera.rotation, scale * camera.translation, *size, camera.distortion)


def _files(source: Path) -> list[Path]:
    """Calibrations among the TOML files of a folder, or the file itself, told by the keys of the first table."""
    named = [source / name for name in entries(source)] or [source]
    return [path for path in named if path.suffix.lower() == ".toml" and _has_cameras(first_bytes(path, FIRST_TABLE))]


def _has_cameras(head: bytes) -> bool:
    return all(re.search(rb"(?m)^\s*%s\s*=" % key, head) for key in (b"matrix", b"rotation", b"translation"))
