"""Decoding of picture files; a damaged file is an error, never a partial picture."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from fourd.errors import UserError

PICTURE_FORMATS = ("JPEG", "PNG")
"""The formats that Pillow may detect by content: others, such as EPS, start other programs."""


def decode_rgb(path: Path) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 RGB of a picture file, pixels as stored (no rotation by EXIF, no colour management).

    Raises:
        UserError: when the file is missing, no JPEG or PNG, or truncated.
    """
    return np.asarray(_open(path, path, "RGB"))


def decode_rgb_bytes(content: bytes, name: str) -> NDArray[np.uint8]:
    """decode_rgb for a picture file's bytes; ``name`` identifies them in errors."""
    return np.asarray(_open(io.BytesIO(content), name, "RGB"))


def decode_matte(path: Path) -> NDArray[np.uint8]:
    """(H, W) uint8 matte of a picture file: its grey value, the upper 8 of 16 bits. Raises as decode_rgb."""
    return np.asarray(_open(path, path, "L"))


def decode_alpha(path: Path) -> NDArray[np.uint8]:
    """(H, W) uint8 alpha channel of a picture file, 255 everywhere if it has none. Raises as decode_rgb."""
    try:
        with Image.open(path, formats=PICTURE_FORMATS) as image:
            return np.array(image.convert("RGBA").getchannel("A"))
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise _damaged(path, error) from error


def picture_size(path: Path) -> tuple[int, int]:
    """(width, height) in pixels from the header alone. Raises as decode_rgb."""
    try:
        with Image.open(path, formats=PICTURE_FORMATS) as image:
            return image.size
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise _damaged(path, error) from error


def _open(file: Path | io.BytesIO, name: Path | str, mode: str) -> Image.Image:
    try:
        with Image.open(file, formats=PICTURE_FORMATS) as image:
            image.load()
            if image.mode.startswith("I;16"):
                return Image.fromarray((np.asarray(image) >> 8).astype(np.uint8)).convert(mode)
            return image.convert(mode)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise _damaged(name, error) from error


def _damaged(name: Path | str, error: Exception) -> UserError:
    if isinstance(error, FileNotFoundError):
        got = "no such file"
    elif isinstance(error, UnidentifiedImageError):
        got = "something else"
    elif isinstance(error, OSError) and error.strerror:
        got = f"'{error.strerror}'"
    else:
        got = f"'{error}'"
    return UserError(f"{name}: expected a whole JPEG or PNG picture, got {got}; copy the file again")
