"""EasyMocap and EasyVolcap: intri.yml and extri.yml beside images/CAM/ or videos/CAM.ext.

Mattes in masks/CAM/ are optional. Captures of fourd use the same files. Pixel coordinates are not converted, because
EasyVolcap and fourd both use COLMAP's convention of pixel coordinates.
"""

from __future__ import annotations

from pathlib import Path

import av

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.recording.capture.calibration import Calibration, read_calibration, require_calibration
from fourd.recording.capture.decoding import picture_size
from fourd.recording.capture.layout import EXTRINSICS_NAME, INTRINSICS_NAME
from fourd.recording.capture.split import read_test_views, require_known
from fourd.recording.capture.video import first_frame
from fourd.recording.importing.folders import find_frames, join_calibrations, list_entries, match_names
from fourd.recording.importing.imported import Frames, Imported, PictureFiles, VideoFile

FRAME_FOLDERS = ("images", "videos", ".")
MASK_FOLDERS = ("masks", "mask")


def looks_like(source: Path) -> bool:
    """Return whether ``source`` is a folder with intri.yml and extri.yml."""
    return {INTRINSICS_NAME, EXTRINSICS_NAME} <= set(list_entries(source))


def is_calibration(path: Path) -> bool:
    """Return whether ``path`` is an intri.yml beside an extri.yml."""
    return path.name == INTRINSICS_NAME and (path.parent / EXTRINSICS_NAME).is_file()


def read_names(path: Path) -> list[str]:
    """Return the names of the cameras of an intri.yml. Raises UserError if the calibration is invalid."""
    return list(read_calibration(path.parent))


def read(source: Path, frames: Path | None = None) -> Imported:
    """Read the cameras of ``source``: a folder with intri.yml and extri.yml, or intri.yml itself.

    Lengths are in the calibration's unit. Cameras of which only one of the two files has values are left out, with a
    note.

    Args:
        source: the folder or intri.yml.
        frames: folder that contains images/, videos/ and masks/, or None for the folder of the calibration.

    Raises:
        UserError: when the calibration files are invalid, no camera with frames has a calibration, or a camera has
            mattes, but not one for each of its images.
    """
    folder = source.parent if source.name == INTRINSICS_NAME else source
    path, data = folder / INTRINSICS_NAME, frames or folder
    report = require_calibration(folder)
    calibrations = report.calibrations
    found_frames = find_frames(data, FRAME_FOLDERS, list(calibrations))
    pairs = match_names([*calibrations, *report.incomplete], found_frames, path)
    found_frames = {camera: of for camera, of in found_frames.items() if pairs.get(camera) not in report.incomplete}
    found = {pairs[camera]: of for camera, of in found_frames.items() if camera in pairs}
    cameras_by_name = {}
    for name, calibration in calibrations.items():
        cameras_by_name[name] = _make_camera(path, name, calibration, found.get(name))
    cameras, notes = join_calibrations(found_frames, cameras_by_name, path, [data / name for name in MASK_FOLDERS])
    kept = "lengths and pixel coordinates are kept as in the calibration"
    test_views = read_test_views(data) or ()
    require_known(data, test_views, [camera.name for camera in cameras])
    lines = (kept, *report.notes, *notes)
    return Imported(cameras, lines, test_views=test_views, metres_per_unit=report.metres_per_unit)


def _make_camera(path: Path, name: str, calibration: Calibration, frames: Frames | None) -> Camera:
    """Make a camera from its calibration.

    If the calibration has no image size, the size is read from the first image, or is 1 x 1 for a camera without
    frames.
    """
    width, height = calibration.width, calibration.height
    if width is None or height is None:
        width, height = (1, 1) if frames is None else _size(frames)
    try:
        return calibration.camera(width, height)
    except ValueError as error:
        raise UserError(f"{path}: camera '{name}': {error}; calibrate that camera again") from error


def _size(frames: Frames) -> tuple[int, int]:
    """Read (width, height) from the header of the first image, or from the upright first frame of a video."""
    if isinstance(frames, PictureFiles):
        return picture_size(frames.paths[0])
    assert isinstance(frames, VideoFile)
    try:
        return first_frame(frames.path)[:2]
    except (av.FFmpegError, OSError, ValueError, IndexError) as error:
        raise UserError(f"{frames.path}: expected a whole video, got '{error}'; copy it again") from error
