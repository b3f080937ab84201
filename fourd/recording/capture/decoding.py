"""Decoding of image files. A damaged file raises an error; it is never decoded to a partial image.

All functions turn images upright as the EXIF orientation says, as OpenCV and image viewers do. Hidden colours, that is,
colours of fully transparent pixels, are replaced by black.
"""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import ExifTags, Image, UnidentifiedImageError

from fourd.base.errors import UserError
from fourd.base.formats.picture_end import has_end
from fourd.base.limits import open_regular

PICTURE_FORMATS = ("JPEG", "PNG", "BMP", "TIFF", "WEBP")
"""Image formats that Pillow may decode. Others are excluded, because Pillow starts external programs for some of them,
such as EPS."""
ALPHA_MODES = ("RGBA", "LA", "PA", "RGBa", "La")
UPRIGHT = {
    2: Image.Transpose.FLIP_LEFT_RIGHT,
    3: Image.Transpose.ROTATE_180,
    4: Image.Transpose.FLIP_TOP_BOTTOM,
    5: Image.Transpose.TRANSPOSE,
    6: Image.Transpose.ROTATE_270,
    7: Image.Transpose.TRANSVERSE,
    8: Image.Transpose.ROTATE_90,
}
"""The change that turns an image upright, for each EXIF orientation except 1, which is upright."""
ERRORS = (OSError, ValueError, SyntaxError, KeyError, TypeError, OverflowError, Image.DecompressionBombError)

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class PictureHeader:
    """Properties of an image file that are known without decoding it.

    Attributes:
        size: (width, height) of the upright image in pixels.
        orientation: EXIF orientation, 1 to 8. The stored image is upright if it is 1.
        has_alpha: whether the file has an alpha channel, or a palette or colour that is transparent.
        bits: 16 if the file has 16 bits per value, otherwise 8.
    """

    size: tuple[int, int]
    orientation: int
    has_alpha: bool
    bits: int

    @property
    def stored_size(self) -> tuple[int, int]:
        """(width, height) of the stored image in pixels, before it is turned upright."""
        return self.size if self.orientation < 5 else (self.size[1], self.size[0])


def read_header(path: Path) -> PictureHeader:
    """Read the header of an image file; raises the same errors as :func:`decode_rgb`."""
    try:
        with open_regular(path) as stream, Image.open(stream, formats=PICTURE_FORMATS) as image:
            return header_of(image)
    except ERRORS as error:
        raise _damaged(path, error) from error


def header_of(image: Image.Image) -> PictureHeader:
    """Return the header of an image that Pillow has opened but not decoded."""
    # Without metadata in the header of a PNG file, getexif would decode the whole image to find metadata behind it.
    has_exif = image.format != "PNG" or not {"exif", "Raw profile type exif"}.isdisjoint(image.info)
    try:
        found = image.getexif().get(ExifTags.Base.Orientation, 1) if has_exif else 1
    except (*ERRORS, struct.error, IndexError):
        found = 1  # Damaged metadata does not make an image unusable.
    orientation = found if found in UPRIGHT else 1
    # Pillow itself turns TIFF images upright, and swaps their sizes when it opens them.
    is_swapped = orientation >= 5 and image.format != "TIFF"
    size = (image.height, image.width) if is_swapped else image.size
    # In the modes RGB and RGBA, only the decoder's arguments show that the file has 16 bits per value.
    arguments = str([tile[3] for tile in getattr(image, "tile", [])])
    bits = 16 if image.mode.startswith("I;16") or ";16" in arguments else 8
    return PictureHeader(size, orientation, image.mode in ALPHA_MODES or "transparency" in image.info, bits)


def picture_size(path: Path) -> tuple[int, int]:
    """Read (width, height) of the upright image in pixels; raises the same errors as :func:`decode_rgb`."""
    return read_header(path).size


def decode_rgb(path: Path) -> Picture:
    """Decode an image file to upright RGB (H, W, 3) uint8, without colour management.

    Values of 16 bits are rounded to 8 bits. Colours are not multiplied by alpha, but hidden colours are black.

    Raises:
        UserError: if the file is missing, is not in one of PICTURE_FORMATS, is truncated, has several pages, or has
            values of more than 16 bits.
    """
    return without_alpha(decode_picture(path))


def decode_rgb_bytes(content: bytes, name: str) -> Picture:
    """Decode the bytes of an image file like :func:`decode_rgb`; ``name`` is the file's name in error messages."""
    return without_alpha(_to_colours(_open(io.BytesIO(content), name), name))


def decode_picture(path: Path, orientation: int | None = None) -> Picture:
    """Decode an image file to RGB (H, W, 3), or RGBA (H, W, 4) if it has alpha; see :func:`decode_rgb`.

    Args:
        path: the file.
        orientation: EXIF orientation that the file must have, or None if any is right.

    Raises:
        UserError: for the same reasons as :func:`decode_rgb`, or if the file has another orientation.
    """
    return _to_colours(decode_image(path, orientation), path)


def check_orientation(path: Path | str, orientation: int, expected: int) -> None:
    """Raise UserError if the EXIF orientation of an image differs from that of the camera's first image."""
    if orientation != expected:
        raise UserError(
            f"{path}: expected EXIF orientation {expected} as in the camera's first image, got {orientation}; a camera "
            "must not turn while it records: correct the orientation of the file, or remove it from all files"
        )


def without_alpha(picture: Picture) -> Picture:
    """Return the RGB values of an image (H, W, 3 or 4). Hidden colours become black."""
    if picture.shape[2] == 3:
        return picture
    return np.where(picture[..., 3:] > 0, picture[..., :3], np.uint8(0))


def decode_matte(path: Path) -> Picture:
    """Decode a matte (H, W) uint8 from an image file's grey values, which are rounded to 8 bits.

    The function raises the same errors as :func:`decode_rgb`.
    """
    image = decode_image(path)
    return _grey16(image) if image.mode.startswith("I;16") else np.asarray(_convert(image, "L", path))


def decode_alpha(path: Path) -> Picture:
    """Decode the alpha channel (H, W) uint8 of an image file; all values are 255 if the file has no alpha channel.

    The function raises the same errors as :func:`decode_rgb`.
    """
    image = decode_image(path)
    if image.mode not in ALPHA_MODES and "transparency" not in image.info:
        return np.full((image.height, image.width), 255, np.uint8)
    return np.array(_convert(image, "RGBA", path).getchannel("A"))


def decode_image(path: Path, orientation: int | None = None) -> Image.Image:
    """Decode an image file to an upright Pillow image in the file's own mode, such as a palette; takes the same
    arguments and raises the same errors as :func:`decode_picture`."""
    try:
        with open_regular(path) as stream:
            return _open(stream, path, orientation)
    except OSError as error:
        raise _damaged(path, error) from error


def _open(file: BinaryIO, name: Path | str, expected: int | None = None) -> Image.Image:
    try:
        with Image.open(file, formats=PICTURE_FORMATS) as image:
            # A JPEG may contain a preview after the image.
            pages = getattr(image, "n_frames", 1) if image.format in ("TIFF", "PNG", "WEBP") else 1
            if pages > 1:
                raise ValueError(f"{pages} pages, expected one image per file")
            orientation = header_of(image).orientation
            check_orientation(name, orientation, orientation if expected is None else expected)
            change = UPRIGHT.get(orientation)
            image.load()
            file.seek(0)
            if not has_end(file.read()):
                raise ValueError("no marker of its end")
            if change is None or image.format == "TIFF":
                return image
            upright = image.transpose(change)
            upright.format = image.format
            return upright
    except ERRORS as error:
        raise _damaged(name, error) from error


def _to_colours(image: Image.Image, name: Path | str) -> Picture:
    """Convert a decoded image to RGB (H, W, 3), or to RGBA (H, W, 4) if it has alpha."""
    if image.mode.startswith("I;16"):
        return np.repeat(_grey16(image)[..., None], 3, axis=2)
    has_alpha = image.mode in ALPHA_MODES or "transparency" in image.info
    return np.asarray(_convert(image, "RGBA" if has_alpha else "RGB", name))


def _convert(image: Image.Image, mode: str, name: Path | str) -> Image.Image:
    if image.mode in ("I", "F"):
        raise UserError(f"{name}: expected 8 or 16 bits per value, got 32; export the file again with 8 bits")
    try:
        return image.convert(mode)
    except ERRORS as error:
        raise _damaged(name, error) from error


def _grey16(image: Image.Image) -> Picture:
    """Round the grey values of an image with 16 bits to 8 bits."""
    values = np.asarray(image).astype(np.uint32)
    return ((values + 128) // 257).astype(np.uint8)


def _damaged(name: Path | str, error: Exception) -> UserError:
    if isinstance(error, FileNotFoundError):
        got = "no such file"
    elif isinstance(error, UnidentifiedImageError):
        got = "another format"
    elif isinstance(error, OSError) and error.strerror:
        got = f"'{error.strerror}'"
    else:
        got = f"'{error}'"
    return UserError(f"{name}: expected a complete JPEG, PNG, BMP, TIFF or WebP image, got {got}; copy the file again")
