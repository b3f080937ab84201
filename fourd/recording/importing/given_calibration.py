"""Use of a calibration that the user specifies for videos, such as the output of fourd calibrate."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from fourd.base.errors import UserError
from fourd.recording.capture.calibration import require_calibration
from fourd.recording.importing.folders import match_names
from fourd.recording.importing.imported import Imported

VIDEOS_FORMAT = "videos"
"""Name of the format of sources without a calibration. Only this format accepts --calibration."""
REPORT = "report.json"
"""File that ``fourd calibrate`` writes beside a calibration, and that other programs do not write."""


def apply_calibration(imported: Imported, format_name: str, folder: Path) -> Imported:
    """Add the calibrations in ``folder`` (intri.yml and extri.yml) to the cameras of a source without a calibration.

    Cameras are matched by :func:`fourd.recording.importing.folders.match_names`. The unit is that of the calibration.
    The calibrations keep their image sizes, which a later step of the import compares with the video sizes.

    Raises:
        UserError: if the format has its own calibration, if the folder has no valid calibration, if the calibration of
            a camera is missing, or if the calibration has no image sizes.
    """
    if format_name != VIDEOS_FORMAT:
        raise UserError(
            f"--calibration: expected the format {VIDEOS_FORMAT}, got {format_name}, which has its own calibration; "
            f"name the format {VIDEOS_FORMAT}, or leave out --calibration"
        )
    report = require_calibration(folder)
    found = report.calibrations
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
    notes = [f"calibration: {folder}", *report.notes]
    unused = sorted(set(found) - set(pairs.values()))
    if unused:
        notes.append(f"cameras without images, not imported: {', '.join(unused)}")
    # Earlier versions of fourd calibrate, which measures in metres, did not write the unit.
    unit = 1.0 if report.metres_per_unit is None and (folder / REPORT).is_file() else report.metres_per_unit
    return replace(imported, cameras=tuple(cameras), notes=tuple(notes), metres_per_unit=unit)
