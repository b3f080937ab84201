"""Images with an alpha channel, which is the matte of captures without masks."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.recording.capture.decoding import decode_alpha, read_header, without_alpha
from fourd.recording.capture.layout import PICTURE_SUFFIXES, camera_folders, find_pictures, sample_indices

Picture = NDArray[np.uint8]

ALPHA_SUFFIXES = tuple(suffix for suffix in PICTURE_SUFFIXES if suffix not in (".jpg", ".jpeg"))
SAMPLES = 3
"""Number of images per camera that are examined for transparent pixels."""
ALPHA_NOTE = "the alpha channel of the images is the matte; hidden colours are not used"


def alpha_is_matte(capture: Path) -> bool:
    """Return whether the alpha channels of a capture's images are its mattes.

    They are if masks/ has no mattes, and a few images of a camera include one with a transparent pixel. A channel that
    is opaque everywhere has no meaning.

    Raises:
        UserError: if an examined image is damaged.
    """
    images = capture / "images"
    return not camera_folders(capture / "masks") and any(_has_holes(images / name) for name in camera_folders(images))


def has_alpha_channel(path: Path) -> bool:
    """Return whether an image file has an alpha channel. Raises UserError if the file is damaged."""
    return read_header(path).has_alpha


def _has_holes(folder: Path) -> bool:
    with os.scandir(folder) as entries:
        if not any(os.path.splitext(entry.name)[1].lower() in ALPHA_SUFFIXES for entry in entries):
            return False
    files = list(find_pictures(folder).values())
    if not files or not has_alpha_channel(folder / files[0]):
        return False
    return any(decode_alpha(folder / files[index]).min() < 255 for index in sample_indices(len(files), SAMPLES))


def resample(picture: Picture, maps: NDArray[np.float32] | None, size: tuple[int, int]) -> Picture:
    """Undistort and scale an image.

    Colours of images with alpha are weighted by alpha, so that no hidden colour reaches a visible pixel.

    Args:
        picture: (H, W), (H, W, 3) or, with alpha, (H, W, 4) uint8.
        maps: position of each pixel in ``picture``; see :func:`fourd.recording.capture.reader.undistortion_maps`. None
            keeps the pixels in place.
        size: new (width, height) in pixels.

    Returns:
        The image without alpha. Colours are not multiplied by alpha, but fully transparent pixels are black.
    """
    is_same = (picture.shape[1], picture.shape[0]) == size
    has_alpha = picture.ndim == 3 and picture.shape[2] == 4
    if not has_alpha or (maps is None and is_same) or picture[..., 3].min() == 255:
        return np.asarray(_resample(without_alpha(picture) if has_alpha else picture, maps, size), np.uint8)
    weighted = picture.astype(np.float32)
    weighted[..., :3] *= weighted[..., 3:] / 255
    weighted = np.asarray(_resample(weighted, maps, size), np.float32)
    alpha = weighted[..., 3:]
    colours = np.where(alpha >= 0.5, weighted[..., :3] * (255 / np.maximum(alpha, 0.5)), 0)
    return np.clip(np.rint(colours), 0, 255).astype(np.uint8)


def _resample(
    picture: cv2.typing.MatLike, maps: NDArray[np.float32] | None, size: tuple[int, int]
) -> cv2.typing.MatLike:
    if maps is not None:
        picture = cv2.remap(picture, maps[0], maps[1], cv2.INTER_LINEAR)
    if (picture.shape[1], picture.shape[0]) != size:
        interpolation = cv2.INTER_AREA if size[0] < picture.shape[1] else cv2.INTER_LINEAR
        picture = cv2.resize(picture, size, interpolation=interpolation)
    return picture
