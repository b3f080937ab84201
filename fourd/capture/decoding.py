"""Decoding of image files. A damaged file raises an error; it is never decoded to a partial image."""

from __future__ import annotations

import io
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from fourd.errors import UserError
from fourd.formats.picture_end import has_end
from fourd.limits import open_regular

PICTURE_FORMATS = ("JPEG", "PNG")
"""Image formats that Pillow may decode. Others are excluded, because Pillow starts external programs for some of them,
such as EPS."""


def decode_rgb(path: Path) -> NDArray[np.uint8]:
    """Decode an image file to RGB (H, W, 3) uint8, without EXIF rotation or colour management.

    Raises:
        UserError: if the file is missing, is not a JPEG or PNG, or is truncated.
    """
    return np.asarray(_decode_file(path, "RGB"))


def decode_rgb_bytes(content: bytes, name: str) -> NDArray[np.uint8]:
    """Decode the bytes of an image file like :func:`decode_rgb`; ``name`` is the file's name in error messages."""
    return np.asarray(_open(io.BytesIO(content), name, "RGB"))


def decode_matte(path: Path) -> NDArray[np.uint8]:
    """Decode a matte (H, W) uint8 from an image file's grey values.

    If the values have 16 bits, only the upper 8 bits are used. The function raises the same errors as
    :func:`decode_rgb`.
    """
    return np.asarray(_decode_file(path, "L"))


def decode_alpha(path: Path) -> NDArray[np.uint8]:
    """Decode the alpha channel (H, W) uint8 of an image file; all values are 255 if the file has no alpha channel.

    The function raises the same errors as :func:`decode_rgb`.
    """
    try:
        with open_regular(path) as stream, Image.open(stream, formats=PICTURE_FORMATS) as image:
            return np.array(image.convert("RGBA").getchannel("A"))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise _damaged(path, error) from error


def picture_size(path: Path) -> tuple[int, int]:
    """Read (width, height) in pixels from an image file's header; raises the same errors as :func:`decode_rgb`."""
    try:
        with open_regular(path) as stream, Image.open(stream, formats=PICTURE_FORMATS) as image:
            return image.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise _damaged(path, error) from error


def _decode_file(path: Path, mode: str) -> Image.Image:
    try:
        with open_regular(path) as stream:
            return _open(stream, path, mode)
    except OSError as error:
        raise _damaged(path, error) from error


def _open(file: BinaryIO, name: Path | str, mode: str) -> Image.Image:
    try:
        with Image.open(file, formats=PICTURE_FORMATS) as image:
            image.load()
            file.seek(0)
            if not has_end(file.read()):
                raise ValueError("no marker of its end")
            if image.mode.startswith("I;16"):
                return Image.fromarray((np.asarray(image) >> 8).astype(np.uint8)).convert(mode)
            return image.convert(mode)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise _damaged(name, error) from error


def _damaged(name: Path | str, error: Exception) -> UserError:
    if isinstance(error, FileNotFoundError):
        got = "no such file"
    elif isinstance(error, UnidentifiedImageError):
        got = "another format"
    elif isinstance(error, OSError) and error.strerror:
        got = f"'{error.strerror}'"
    else:
        got = f"'{error}'"
    return UserError(f"{name}: expected a complete JPEG or PNG image, got {got}; copy the file again")
