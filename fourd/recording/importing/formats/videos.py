"""Importer of a folder that contains videos or folders of images, without a calibration."""

from __future__ import annotations

from pathlib import Path

from fourd.base.errors import UserError
from fourd.recording.importing.folders import find_frames
from fourd.recording.importing.imported import Imported, ImportedCamera


def looks_like(source: Path) -> bool:
    """Return whether ``source`` contains a video or a folder of images."""
    try:
        return bool(find_frames(source))
    except (UserError, OSError):
        return False


def read(source: Path) -> Imported:
    """Read the cameras of ``source``, without calibration.

    Raises:
        UserError: when ``source`` contains no cameras, or two cameras have the same name.
    """
    cameras = tuple(ImportedCamera(name, None, frames) for name, frames in find_frames(source).items())
    return Imported(cameras, ("no calibration found: cameras are calibrated from their images",))
