"""EasyMocap and EasyVolcap: intri.yml and extri.yml beside images/CAM/ or videos/CAM.ext, perhaps masks/CAM/.

Pixels are taken as they are: this project's own captures have this layout, and EasyVolcap writes COLMAP's there.
"""

from __future__ import annotations

from pathlib import Path

import av

from fourd.cameras import Camera
from fourd.capture.calibration import EXTRINSICS_NAME, INTRINSICS_NAME, Calibration, read_calibration
from fourd.capture.decoding import picture_size
from fourd.errors import UserError
from fourd.importing.formats.folders import entries, frames_in, matched, with_lenses
from fourd.importing.formats.imported import Frames, Imported, PictureFiles, VideoFile

PLACES = ("images", "videos", ".")
MASKS = ("masks", "mask")


def looks_like(source: Path) -> bool:
    """Whether ``source`` is a folder with intri.yml and extri.yml."""
    return {INTRINSICS_NAME, EXTRINSICS_NAME} <= set(entries(source))


def read(source: Path) -> Imported:
    """Cameras of ``source``, in the calibration's own unit of length.

    Raises:
        UserError: as read_calibration, when cameras and calibrations do not match, or a picture has no matte.
    """
    path = source / INTRINSICS_NAME
    calibrations = read_calibration(source)
    frames = frames_in(source, PLACES)
    found = {name: frames[camera] for camera, name in matched(list(calibrations), frames, path).items()}
    lenses = {}
    for name, calibration in calibrations.items():
        lenses[name] = _lens(path, name, calibration, found.get(name))
    cameras, notes = with_lenses(frames, lenses, path, [source / folder for folder in MASKS])
    return Imported(cameras, ("lengths and pixels as the calibration has them", *notes))


def _lens(path: Path, name: str, calibration: Calibration, frames: Frames | None) -> Camera:
    """The camera; a size that the files lack is that of its first picture, or of nothing where it has none."""
    width, height = calibration.width, calibration.height
    if width is None or height is None:
        width, height = (1, 1) if frames is None else _size(frames)
    try:
        return calibration.camera(width, height)
    except ValueError as error:
        raise UserError(f"{path}: camera '{name}': {error}; calibrate that camera again") from error


def _size(frames: Frames) -> tuple[int, int]:
    """(width, height) from a header."""
    if isinstance(frames, PictureFiles):
        return picture_size(frames.paths[0])
    assert isinstance(frames, VideoFile)
    try:
        with av.open(str(frames.path)) as container:
            stream = container.streams.video[0]
            return stream.width, stream.height
    except (av.FFmpegError, OSError, ValueError, IndexError) as error:
        raise UserError(f"{frames.path}: expected a whole video, got '{error}'; copy it again") from error
