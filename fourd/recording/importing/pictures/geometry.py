"""Checks the sizes and orientations of a source's image files, and turns calibrations of stored images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.progress import Track
from fourd.recording.capture.decoding import PictureHeader, check_orientation, read_header
from fourd.recording.capture.pictures.bits import check_bits
from fourd.recording.capture.pictures.orientation import TURNS, fits_stored_only
from fourd.recording.import_choices import CalibratedFrames
from fourd.recording.importing.frame_geometry import turn_camera
from fourd.recording.importing.imported import Imported, ImportedCamera, PictureFiles


def match_pictures(imported: Imported, meant: CalibratedFrames, track: Track) -> tuple[Imported, list[str]]:
    """Check the headers of all image files, and turn the calibrations of images that EXIF metadata turns upright.

    Args:
        imported: the content of a source.
        meant: whether calibrations belong to the stored or to the upright ("turned") images. With "auto", a calibration
            belongs to the stored images only if it does not fit the upright images; see
            :func:`~fourd.recording.capture.pictures.orientation.fits_stored_only`.
        track: wraps loops to report progress.

    Returns:
        The source with the turned calibrations, and notes for the user.

    Raises:
        UserError: if the size or orientation changes within a camera, a matte has another size than the images, or a
            calibration cannot be turned.
    """
    cameras, groups = [], dict[str, list[str]]()
    for camera in imported.cameras:
        found = camera
        if isinstance(camera.frames, PictureFiles):
            header = check_headers(camera.name, camera.frames.paths, track)
            check_bits(camera.frames.paths)
            _check_mattes(camera, header)
            found, note = _turn(camera, header, meant)
            if note is not None:
                groups.setdefault(note, []).append(camera.name)
        cameras.append(found)
    notes = [f"{', '.join(names)}: {note}" for note, names in groups.items()]
    return replace(imported, cameras=tuple(cameras)), notes


def check_headers(name: str, paths: Sequence[Path], track: Track) -> PictureHeader:
    """Check that all images of a camera have the size and orientation of the first one. Returns the first header."""
    first = read_header(paths[0])
    for path in track(paths, len(paths), f"{name}: sizes"):
        header = read_header(path)
        check_orientation(path, header.orientation, first.orientation)
        if header.size != first.size:
            raise UserError(
                f"{path}: expected {first.size[0]} x {first.size[1]} pixels like {paths[0].name}, the first image of "
                f"camera '{name}', got {header.size[0]} x {header.size[1]}; export the image again at the expected "
                "size, or move it away"
            )
    return first


def _check_mattes(camera: ImportedCamera, header: PictureHeader) -> None:
    for path in camera.masks.paths if isinstance(camera.masks, PictureFiles) else ():
        size = read_header(path).size
        if size != header.size:
            raise UserError(
                f"{path}: expected {header.size[0]} x {header.size[1]} pixels like the images of camera "
                f"'{camera.name}', got {size[0]} x {size[1]}; export the mask again at the expected size"
            )


def _turn(camera: ImportedCamera, header: PictureHeader, meant: CalibratedFrames) -> tuple[ImportedCamera, str | None]:
    """Turn the calibration of a camera if it belongs to stored images that are turned. Returns a note on the turn."""
    if header.orientation == 1:
        return camera, None
    text = f"images are turned upright (EXIF orientation {header.orientation})"
    calibration = camera.calibration
    if calibration is None:
        return camera, text
    is_stored = fits_stored_only(calibration, header) if meant == "auto" else meant == "stored"
    if not is_stored:
        cure = "" if meant != "auto" else "; change this with --calibrated-frames stored"
        return camera, f"{text}; the calibration belongs to the upright images{cure}"
    if header.orientation not in TURNS:
        raise UserError(
            f"camera '{camera.name}': expected a calibration of the upright images, since EXIF orientation "
            f"{header.orientation} mirrors the images, got one of the stored images; calibrate the upright images"
        )
    turned = _turned(camera.name, _with_stored_shape(calibration, header), TURNS[header.orientation])
    return replace(camera, calibration=turned), f"{text}; the calibration of the stored images is turned too"


def _with_stored_shape(calibration: Camera, header: PictureHeader) -> Camera:
    """Correct the image size of a calibration that was taken from the upright images, because it had none."""
    width, height = header.size
    stored_width, stored_height = header.stored_size
    if (calibration.width, calibration.height) == (width, height):
        return replace(calibration, width=stored_width, height=stored_height)
    return calibration


def _turned(name: str, calibration: Camera, degrees: int) -> Camera:
    try:
        return turn_camera(calibration, degrees)
    except ValueError as error:
        raise UserError(f"camera '{name}': {error}; calibrate the upright images") from error
