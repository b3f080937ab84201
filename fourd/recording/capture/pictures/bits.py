"""Images whose 16-bit values use only the lower bits, as those of cameras with 10 or 12 bits."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fourd.base.errors import UserError
from fourd.recording.capture.decoding import decode_rgb, read_header
from fourd.recording.capture.layout import sample_indices

SAMPLES = 3
"""Number of images per camera that are examined."""
MAX_DARK = 16
"""Largest value, after scaling to 8 bits, of images that use at most 12 of 16 bits."""


def check_bits(files: Sequence[Path]) -> None:
    """Check that the images of a camera use all their bits. Images with 8 bits per value are not decoded.

    Raises:
        UserError: if the examined images have 16 bits per value, and no value above 12 bits.
    """
    if not files or read_header(files[0]).bits == 8:
        return
    largest = max(int(decode_rgb(files[index]).max()) for index in sample_indices(len(files), SAMPLES))
    if 0 < largest <= MAX_DARK:
        raise UserError(
            f"{files[0]}: expected values of 16 bits up to 65535, got at most about {257 * largest} in the examined "
            "images, which are almost black; if the camera has 10 or 12 bits, multiply the values by 64 or 16"
        )
