"""Anipose, Pose2Sim and FreeMoCap: a calibration TOML with one table per camera.

Each table contains a world-to-camera pose. Anipose and Pose2Sim calibrate with OpenCV, in which the origin of pixel
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

KEYS = ("name", "size", "matrix", "distortions", "rotation", "translation")
HEAD_BYTES = 1 << 18
"""Number of bytes at the start of a file that always contain the table of its first camera."""
METRES_PER_MM = 1e-3
MAX_DISTANCE_M = 100.0
"""Largest plausible median distance between cameras in metres. A file with a larger median distance is assumed to be in
millimetres."""


def looks_like(source: Path) -> bool:
    """Return whether ``source`` is a calibration TOML, or a folder with one."""
    return bool(_find_files(source))


def is_calibration(path: Path) -> bool:
    """Return whether ``path`` is a calibration TOML of Anipose, Pose2Sim or FreeMoCap."""
    return path.suffix.lower() == ".toml" and _has_cameras(read_head(path, HEAD_BYTES))


def read_names(path: Path) -> list[str]:
    """Return the names of the cameras of a calibration file. Raises UserError if the file is invalid."""
    return list(read_cameras(path)[0])


def read(source: Path, frames: Path | None = None) -> Imported:
    """Read the cameras of ``source``: a folder with the TOML, or the TOML file itself.

    Args:
        source: the folder or the TOML.
        frames: folder that contains the cameras' videos, or None for the folder of the TOML.

    Raises:
        UserError: when there is no calibration TOML or more than one, the TOML is invalid, a value is missing or
            invalid, a lens is a fisheye, or no camera in the TOML has a video.
    """
    files = _find_files(source)
    if len(files) != 1:
        got = " and ".join(path.name for path in files) or "none"
        raise UserError(f"{source}: expected one TOML with the cameras' calibration, got {got}; name the file itself")
    path = files[0]
    calibrations, notes = read_cameras(path)
    cameras, more = join_calibrations(find_frames(frames or path.parent, names=list(calibrations)), calibrations, path)
    return Imported(cameras, (*notes, *more))


def read_cameras(path: Path) -> tuple[dict[str, Camera], list[str]]:
    """Read a calibration TOML. Returns two values: the cameras, keyed by name, and a list of notes for the user. Raises
    UserError if the TOML is invalid, a value is missing or invalid, or a lens is a fisheye."""
    data = read_toml(path)
    cameras: dict[str, Camera] = {}
    for key, table in data.items():
        if key == "metadata" or not isinstance(table, dict):
            continue
        where = f"{path}: [{key}]"
        missing = [required for required in KEYS if required not in table]
        if missing:
            raise UserError(f"{where}: expected {', '.join(KEYS)}, got no {missing[0]}; calibrate again")
        name = table["name"]
        if not isinstance(name, str) or not name or name in cameras:
            raise UserError(f"{where}: expected a unique camera name, got '{name}'; rename one camera")
        cameras[name] = _make_camera(where, table)
    if not cameras:
        raise UserError(f"{path}: expected a table for each camera, got none; calibrate again")
    scale, unit = _guess_unit(list(cameras.values()))
    cameras = {name: _scale_camera(camera, scale) for name, camera in cameras.items()}
    notes = [unit, "half a pixel is added to the principal points, because the origin was the first pixel's centre"]
    metadata = data.get("metadata")
    if isinstance(metadata, dict):
        facts = [
            f"{key} {metadata[key]}" for key in ("adjusted", "error") if isinstance(metadata.get(key), int | float)
        ]
        notes += [f"metadata of the calibration: {', '.join(facts)}"] if facts else []
    return cameras, notes


def _make_camera(where: str, table: dict[str, object]) -> Camera:
    vector = parse_numbers(f"{where}: rotation", table["rotation"], (3,))
    rotation = np.asarray(cv2.Rodrigues(vector)[0], np.float64)
    translation = parse_numbers(f"{where}: translation", table["translation"], (3,))
    return camera_of_table(where, table, rotation, translation)


def _guess_unit(cameras: list[Camera]) -> tuple[float, str]:
    """Guess from the distances between cameras whether the file's unit is the metre or the millimetre. Returns the
    unit, as a length in metres, and a note."""
    centres = np.stack([camera.centre for camera in cameras])
    distances = np.linalg.norm(centres[:, None] - centres[None], axis=2)[np.triu_indices(len(centres), 1)]
    if not len(distances):
        return 1.0, "lengths are kept: one camera is not enough to estimate the unit"
    median = float(np.median(distances))
    if median > MAX_DISTANCE_M:
        return (
            METRES_PER_MM,
            f"the unit is assumed to be millimetres, because the median distance between cameras is {median:.0f}; "
            "lengths are converted to metres",
        )
    return 1.0, f"the unit is assumed to be metres, because the median distance between cameras is {median:.3g}"


def _scale_camera(camera: Camera, scale: float) -> Camera:
    size = (camera.width, camera.height)
    return Camera(camera.intrinsics, camera.rotation, scale * camera.translation, *size, camera.distortion)


def _find_files(source: Path) -> list[Path]:
    """Find calibration files: ``source`` itself, or TOML files in the folder ``source``.

    A calibration file is recognised by the keys of its first table.
    """
    candidates = [source / name for name in list_entries(source)] or [source]
    return [path for path in candidates if is_calibration(path)]


def _has_cameras(head: bytes) -> bool:
    return all(re.search(rb"(?m)^\s*%s\s*=" % key, head) for key in (b"name", b"matrix", b"rotation", b"translation"))
