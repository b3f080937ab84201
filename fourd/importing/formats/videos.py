"""A folder of videos, or of folders of pictures, and nothing known of the cameras."""

from __future__ import annotations

from pathlib import Path

from fourd.errors import UserError
from fourd.importing.formats.folders import frames_in
from fourd.importing.formats.imported import Imported, ImportedCamera


def looks_like(source: Path) -> bool:
    """Whether ``source`` has a video or a folder of pictures for a camera."""
    try:
        return bool(frames_in(source))
    except (UserError, OSError):
        return False


def read(source: Path) -> Imported:
    """Cameras of ``source``, none with a lens.

    Raises:
        UserError: when there are none, or two of one name.
    """
    cameras = tuple(ImportedCamera(name, None, frames) for name, frames in frames_in(source).items())
    return Imported(cameras, ("no calibration found: the cameras are to be calibrated from their pictures",))
