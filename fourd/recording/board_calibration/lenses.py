"""Known lenses of cameras, read from files of Caliscope, Anipose, Pose2Sim and EasyMocap."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.recording.capture.calibration import read_intrinsics
from fourd.recording.importing.folders import match_names, read_file
from fourd.recording.importing.readers.opencv_toml import camera_of_table

MAX_ASPECT_DIFFERENCE = 0.01
"""Maximum relative difference between the aspect ratio of the images for which a lens was calibrated and that of the
camera's images."""


def read_lenses(path: Path) -> dict[str, Camera]:
    """Read the lens of each camera, by camera name. The poses of the returned cameras are the identity.

    Args:
        path: a folder with intri.yml, or a TOML file of Caliscope (camera_array.toml), Anipose or Pose2Sim, in which
            each camera is a table with ``size``, ``matrix`` and ``distortions``. The pixel coordinates of TOML files
            start at the centre of the first pixel, so half a pixel is added to the principal points.

    Raises:
        UserError: if the file is missing or damaged, contains no camera, or a value is invalid.
    """
    if path.is_dir():
        return read_intrinsics(path)
    try:
        data = tomllib.loads(read_file(path).decode())
    except (ValueError, RecursionError) as error:
        raise UserError(
            f"--intrinsics: {path}: expected TOML or a folder with intri.yml, got '{error}'; calibrate again"
        ) from error
    lenses = {}
    for key, table in _camera_tables(data):
        where = f"{path}: [{key}]"
        for needed in ("size", "matrix", "distortions"):
            if needed not in table:
                raise UserError(f"{where}: expected size, matrix and distortions, got no {needed}; calibrate again")
        name = str(table.get("name", key.rpartition(".")[2]))
        lenses[name] = camera_of_table(where, table, np.eye(3), np.zeros(3))
    if not lenses:
        raise UserError(f"{path}: expected a table with size, matrix and distortions for each camera, got none")
    return lenses


def match_lenses(
    path: Path, lenses: dict[str, Camera], names: Sequence[str], sizes: Sequence[tuple[int, int]]
) -> tuple[Camera | None, ...]:
    """Choose the lens of each camera by name, and scale it to the size of the camera's images. The result is
    None for cameras without a lens in ``lenses``.

    Raises:
        UserError: if the file contains a camera without a video, or a lens was calibrated for images of another aspect
            ratio than the camera's images.
    """
    pairs = match_names(list(lenses), names, path)
    for unknown in sorted(set(lenses) - set(pairs.values())):
        raise UserError(
            f"--intrinsics: {path}: expected cameras among {', '.join(names)}, got '{unknown}'; rename or remove it"
        )
    found = []
    for name, (width, height) in zip(names, sizes, strict=True):
        lens = lenses[pairs[name]] if name in pairs else None
        if lens is not None and (lens.width, lens.height) != (width, height):
            if abs(np.log(lens.width / lens.height * height / width)) > MAX_ASPECT_DIFFERENCE:
                raise UserError(
                    f"--intrinsics: {path}: {name}: expected a lens for images of {width} x {height}, got "
                    f"{lens.width} x {lens.height}, which has another aspect ratio; calibrate that lens again"
                )
            lens = lens.resize(width, height)
        found.append(lens)
    return tuple(found)


def _camera_tables(data: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the key and the table of each camera in a TOML file. A camera's table contains a ``matrix``, and is at the
    top level or one level below."""
    for key, table in data.items():
        if not isinstance(table, dict) or key == "metadata":
            continue
        if "matrix" in table:
            yield prefix + key, table
        elif not prefix:
            yield from _camera_tables(table, f"{key}.")
