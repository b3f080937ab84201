"""Detect and match SIFT features in images, and compute fundamental matrices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray

from fourd.cameras import Camera
from fourd.stereo.view import StereoView

Floats = NDArray[np.float32]
Array = NDArray[np.float64]

IMAGES, MASKS = "images", "masks"
MAX_FEATURES = 4096
MAX_SIDE_PX = 1600
"""Maximum length of an image's longer side in pixels. Larger images are reduced to this size before feature
detection."""
MIN_CONTRAST = 0.003
"""SIFT's peak threshold. It is lower than COLMAP's default of 0.0067, because walls have low contrast. This also gives
more wrong matches, but they lie off the epipolar lines of the known poses and are rejected."""
HOLE_MARGIN_PX = 6
"""Minimum distance in pixels between a feature and the holes of a plate, because plates are blurred near holes."""
RATIO_TEST_THRESHOLD = 0.8
"""Maximum ratio d1 / d2 in Lowe's ratio test (IJCV 2004): d1 and d2 are the distances to the nearest and to the second
nearest descriptor."""
MAX_EXHAUSTIVE_CAMERAS = 8
"""Maximum number of cameras for which all pairs are matched."""
MIN_COSINE = 0.4
"""Minimum cosine of the angle between the viewing directions of two cameras that are matched."""


@dataclass(frozen=True, eq=False)
class Features:
    """Features of one image: positions ``xy`` (N, 2) in pixels and unit-length ``descriptors`` (N, 128)."""

    xy: Array
    descriptors: Floats


def pairs_to_match(cameras: Sequence[Camera]) -> list[tuple[int, int]]:
    """Select the camera pairs to match.

    If there are at most 8 cameras, all pairs are matched. Otherwise, two cameras are matched only if their viewing
    directions differ by less than 66 degrees.
    """
    return [
        (i, j)
        for i, j in combinations(range(len(cameras)), 2)
        if len(cameras) <= MAX_EXHAUSTIVE_CAMERAS or cameras[i].forward @ cameras[j].forward > MIN_COSINE
    ]


def write_pictures(folder: Path, plates: Sequence[StereoView]) -> list[str]:
    """Write the plates, and masks of their visible areas, for COLMAP. Returns the file names in the order of the
    plates."""
    images, masks = folder / IMAGES, folder / MASKS
    images.mkdir()
    masks.mkdir()
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * HOLE_MARGIN_PX + 1,) * 2)
    names = [f"{index:06d}.png" for index in range(len(plates))]
    for name, plate in zip(names, plates, strict=True):
        free = cv2.erode(np.where(plate.seen, 255, 0).astype(np.uint8), disc)
        for path, picture in ((images / name, plate.rgb[..., ::-1]), (masks / f"{name}.png", free)):
            if not cv2.imwrite(str(path), np.ascontiguousarray(picture)):
                raise OSError(f"{path}: cannot write this temporary image")
    return names


def extract_features(folder: Path, database: Path, names: list[str]) -> None:
    """Detect features in the images written by :func:`write_pictures` and add them to the COLMAP ``database``."""
    extraction = pycolmap.FeatureExtractionOptions(use_gpu=False)
    # Neighbouring cameras in a typical ring are at least 18 degrees apart. At such angles, only affine-covariant
    # features match.
    extraction.sift.estimate_affine_shape = True
    extraction.sift.peak_threshold = MIN_CONTRAST
    extraction.sift.max_num_features = MAX_FEATURES
    extraction.max_image_size = MAX_SIDE_PX
    reader = pycolmap.ImageReaderOptions(camera_model="PINHOLE", mask_path=folder / MASKS)
    mode = pycolmap.CameraMode.PER_IMAGE
    pycolmap.extract_features(database, folder / IMAGES, names, mode, reader, extraction, pycolmap.Device.cpu)


def read_features(store: Any, image: int) -> Features:
    """Read the features of an image from the COLMAP database ``store``."""
    xy = np.asarray(store.read_keypoints(image), np.float64)[:, :2]
    descriptors = np.asarray(store.read_descriptors(image).data, np.float32)
    lengths = np.linalg.norm(descriptors, axis=1, keepdims=True)
    return Features(xy, descriptors / np.maximum(lengths, 1e-9))


def match_features(first: Features, second: Features) -> NDArray[np.intp]:
    """Find index pairs (M, 2) of features that are mutual nearest neighbours and pass the ratio test."""
    if min(len(first.xy), len(second.xy)) < 2:
        return np.zeros((0, 2), np.intp)
    similarity = first.descriptors @ second.descriptors.T
    best = similarity.argmax(axis=1)
    mutual = similarity.argmax(axis=0)[best] == np.arange(len(best))
    nearest = np.partition(similarity, -2, axis=1)[:, -2:]
    distance = np.sqrt(np.maximum(2 - 2 * nearest, 0))
    kept = np.flatnonzero(mutual & (distance[:, 1] < RATIO_TEST_THRESHOLD * distance[:, 0]))
    return np.column_stack([kept, best[kept]])


def fundamental_matrix(camera: Camera, other: Camera) -> Array:
    """Compute the (3, 3) fundamental matrix F. If x is a pixel of ``camera``, F @ x is its epipolar line in the image
    of ``other``."""
    rotation = other.rotation @ camera.rotation.T
    x, y, z = other.translation - rotation @ camera.translation
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ rotation
    return np.asarray(np.linalg.inv(other.intrinsics).T @ essential @ np.linalg.inv(camera.intrinsics), np.float64)


class QuietColmap:
    """Context manager that limits COLMAP's log on stderr to errors."""

    def __enter__(self) -> None:
        self._before = pycolmap.logging.minloglevel
        pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)

    def __exit__(self, *error: object) -> None:
        pycolmap.logging.minloglevel = self._before
