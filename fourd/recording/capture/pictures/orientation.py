"""Images that EXIF metadata turns upright, and calibrations that belong to the images as the files store them."""

from __future__ import annotations

from pathlib import Path

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.recording.capture.decoding import PictureHeader

TURNS = {1: 0, 3: 180, 6: 270, 8: 90}
"""Counter-clockwise turn in degrees that makes an image upright, by EXIF orientation. The other orientations mirror."""
MAX_CENTRED = 0.1
MIN_OFF_CENTRE = 0.2
"""A principal point is near the centre of an image if its distance is at most MAX_CENTRED of width and height, and far
from it above MIN_OFF_CENTRE of either."""


def fits_stored_only(camera: Camera, header: PictureHeader) -> bool:
    """Return whether a calibration belongs to the stored image of a file, and not to the upright image.

    It does if only the stored image has its orientation (portrait or landscape), or if its principal point is near the
    centre of the stored image and far from the centre of the upright image.
    """
    if header.orientation < 5:
        return False
    (width, height), (stored_width, stored_height) = header.size, header.stored_size
    if width == height:
        return False
    if camera.width != camera.height and (camera.width > camera.height) == (stored_width > stored_height):
        return True
    scale = camera.width / width
    is_far = _off_centre(camera, scale * width, scale * height) > MIN_OFF_CENTRE
    return is_far and _off_centre(camera, scale * stored_width, scale * stored_height) <= MAX_CENTRED


def check_turned(name: str, camera: Camera, file: Path, header: PictureHeader) -> None:
    """Raise UserError if the calibration of camera ``name`` belongs to images that are not turned upright.

    Args:
        name: the camera's name.
        camera: its calibration.
        file: one of its images.
        header: the header of this image.
    """
    if fits_stored_only(camera, header):
        stored, size = header.stored_size, header.size
        raise UserError(
            f"{file}: expected a calibration of the upright images ({size[0]} x {size[1]}) of camera '{name}', since "
            f"EXIF orientation {header.orientation} turns them, got a calibration of the stored images "
            f"({stored[0]} x {stored[1]}); turn the calibration too with: fourd import CAPTURE NEW_CAPTURE"
        )


def _off_centre(camera: Camera, width: float, height: float) -> float:
    """Return the distance of the principal point from the centre of an image, relative to the image's size."""
    k = camera.intrinsics
    return float(max(abs(k[0, 2] / width - 0.5), abs(k[1, 2] / height - 0.5)))
