"""Features of plates or pictures, which of two pictures' are alike, and the epipolar lines of one in the other."""

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

from fourd.background.plates import PlateView
from fourd.cameras import Camera

Floats = NDArray[np.float32]
Array = NDArray[np.float64]

IMAGES, MASKS = "images", "masks"
MOST_FEATURES = 4096
LONGEST_SIDE = 1600
"""Pixels; features of larger pictures are sought in reduced ones."""
FAINTEST = 0.003
"""Of a feature's contrast; COLMAP takes 0.0067. Walls are smooth, and known poses sort out more wrong matches."""
HOLE_MARGIN_PX = 6
"""Beside holes the plate is filled in or soft."""
CLEARLY = 0.8
"""Ratio of distances, of the nearest and the next descriptor (Lowe, IJCV 2004)."""
ALL_PAIRS = 8
LEAST_COSINE = 0.4


@dataclass(frozen=True, eq=False)
class Features:
    """Places xy (N, 2) in pixels, and descriptors (N, 128) of length 1."""

    xy: Array
    descriptors: Floats


def likely_pairs(cameras: Sequence[Camera]) -> list[tuple[int, int]]:
    """Pairs to match: all of up to 8 cameras, else those whose viewing directions are within 66 degrees."""
    return [
        (i, j)
        for i, j in combinations(range(len(cameras)), 2)
        if len(cameras) <= ALL_PAIRS or cameras[i].forward @ cameras[j].forward > LEAST_COSINE
    ]


def write_pictures(folder: Path, plates: Sequence[PlateView]) -> list[str]:
    """Write the plates and the masks of where features may lie; the pictures' names, by number."""
    images, masks = folder / IMAGES, folder / MASKS
    images.mkdir()
    masks.mkdir()
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * HOLE_MARGIN_PX + 1,) * 2)
    names = [f"{index:06d}.png" for index in range(len(plates))]
    for name, plate in zip(names, plates, strict=True):
        free = cv2.erode(np.where(plate.seen, 255, 0).astype(np.uint8), disc)
        for path, picture in ((images / name, plate.rgb[..., ::-1]), (masks / f"{name}.png", free)):
            if not cv2.imwrite(str(path), np.ascontiguousarray(picture)):
                raise OSError(f"{path}: a temporary picture could not be written")
    return names


def extract(folder: Path, database: Path, names: list[str]) -> None:
    """Add the features of some of the pictures that :func:`write_pictures` wrote to COLMAP's ``database``."""
    extraction = pycolmap.FeatureExtractionOptions(use_gpu=False)
    # Cameras of a ring stand 18 degrees apart or more: features that follow the surface's slant are what they share.
    extraction.sift.estimate_affine_shape = True
    extraction.sift.peak_threshold = FAINTEST
    extraction.sift.max_num_features = MOST_FEATURES
    extraction.max_image_size = LONGEST_SIDE
    reader = pycolmap.ImageReaderOptions(camera_model="PINHOLE", mask_path=folder / MASKS)
    mode = pycolmap.CameraMode.PER_IMAGE
    pycolmap.extract_features(database, folder / IMAGES, names, mode, reader, extraction, pycolmap.Device.cpu)


def read_features(store: Any, image: int) -> Features:
    """The features of an image of COLMAP's database ``store``."""
    xy = np.asarray(store.read_keypoints(image), np.float64)[:, :2]
    descriptors = np.asarray(store.read_descriptors(image).data, np.float32)
    lengths = np.linalg.norm(descriptors, axis=1, keepdims=True)
    return Features(xy, descriptors / np.maximum(lengths, 1e-9))


def alike(first: Features, second: Features) -> NDArray[np.intp]:
    """(M, 2) features that are each other's nearest, clearly nearer than the next of the whole picture."""
    if min(len(first.xy), len(second.xy)) < 2:
        return np.zeros((0, 2), np.intp)
    likeness = first.descriptors @ second.descriptors.T
    best = likeness.argmax(axis=1)
    mutual = likeness.argmax(axis=0)[best] == np.arange(len(best))
    nearest = np.partition(likeness, -2, axis=1)[:, -2:]
    apart = np.sqrt(np.maximum(2 - 2 * nearest, 0))
    kept = np.flatnonzero(mutual & (apart[:, 1] < CLEARLY * apart[:, 0]))
    return np.column_stack([kept, best[kept]])


def fundamental_matrix(camera: Camera, other: Camera) -> Array:
    """(3, 3): F x is the line in the other picture of x in the first."""
    rotation = other.rotation @ camera.rotation.T
    x, y, z = other.translation - rotation @ camera.translation
    essential = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) @ rotation
    return np.asarray(np.linalg.inv(other.intrinsics).T @ essential @ np.linalg.inv(camera.intrinsics), np.float64)


class Quiet:
    """COLMAP tells its progress on stderr, line by line; errors still show."""

    def __enter__(self) -> None:
        self._before = pycolmap.logging.minloglevel
        pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)

    def __exit__(self, *error: object) -> None:
        pycolmap.logging.minloglevel = self._before
