"""A calibration that the user gives for videos, such as one written by fourd calibrate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from fourd.capture.calibration import read_calibration
from fourd.errors import UserError
from fourd.importing.folders import match_names
from fourd.importing.imported import Imported

VIDEOS_FORMAT = "videos"
"""Name of the only format whose sources take a calibration."""
REPORT = "report.json"
"""File that only ``fourd calibrate`` writes beside a calibration."""


def is_metric_calibration(folder: Path) -> bool:
    """Whether ``fourd calibrate`` wrote the calibration in ``folder``, which is then in metres."""
    return (folder / REPORT).is_file()


def apply_calibration(imported: Imported, format_name: str, folder: Path) -> Imported:
    """Give the cameras of a source without calibration the calibrations in ``folder`` (intri.yml and extri.yml).

    Cameras are matched by :func:`fourd.importing.folders.match_names`. The size of the calibration's images is kept;
    the import compares it with the size of the videos.

    Raises:
        UserError: if the format has its own calibration, the folder has no valid calibration, a camera has none, or the
            calibration has no image sizes.
    """
    if format_name != VIDEOS_FORMAT:
        raise UserError(
            f"--calibration: expected the format {VIDEOS_FORMAT}, got {format_name}, which has its own calibration; "
            f"name the format {VIDEOS_FORMAT}, or leave out --calibration"
        )
    found = read_calibration(folder)
    pairs = match_names(list(found), [camera.name for camera in imported.cameras], folder)
    cameras = []
    for camera in imported.cameras:
        if camera.name not in pairs:
            raise UserError(
                f"--calibration: {folder}: expected a calibration of each camera, got none for {camera.name}; "
                "calibrate all cameras together, or move this camera's video away"
            )
        given = found[pairs[camera.name]]
        if given.width is None or given.height is None:
            raise UserError(
                f"--calibration: {folder}: expected the image size of camera '{pairs[camera.name]}', got none; add W_ "
                "and H_ of this camera to intri.yml"
            )
        cameras.append(replace(camera, calibration=given.camera(given.width, given.height)))
    notes = [f"calibration: {folder}"]
    unused = sorted(set(found) - set(pairs.values()))
    if unused:
        notes.append(f"cameras without images, not imported: {', '.join(unused)}")
    return replace(imported, cameras=tuple(cameras), notes=tuple(notes))
