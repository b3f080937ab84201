"""Features of images in a temporary COLMAP database."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
from numpy.typing import NDArray

from fourd.base.parallel import core_count
from fourd.base.progress import Track, untracked
from fourd.recording.stereo.features import Features

Array = NDArray[np.float64]
Indices = NDArray[np.uint32]
Picture = NDArray[np.uint8]

MAX_FEATURES = 4096
MIN_CONTRAST = 0.003
"""SIFT's peak threshold. It is lower than COLMAP's default of 0.0067, because walls have low contrast, and because a
recorded ring of 20 cameras needs weak features. This also gives more wrong matches, but they lie off the epipolar lines
and are rejected."""

MIN_AFFINE_SIDE_PX = 16
"""Minimum length of an image's shorter side in pixels for affine-covariant features. On smaller images, COLMAP's
detector of these features crashes, and with it the process."""
COLMAP_SIDE_PX = 3200
"""COLMAP's default for the maximum length of an image's longer side in pixels."""


@dataclass(frozen=True)
class Extraction:
    """Settings of the feature detector.

    Attributes:
        camera_model: COLMAP's model of the cameras.
        is_camera_shared: whether one camera took all images.
        domain_size_pooling: whether descriptors are averaged over several sizes of their image patches. This matches
            images with a wider baseline, and takes longer.
        max_side_px: maximum length of an image's longer side in pixels, or None for COLMAP's default of 3200. Larger
            images are reduced to this size before feature detection.
        batch: whether to detect the features of one image per core at a time, and to report the progress. A shared
            camera needs the features of all images at once.
    """

    camera_model: str = "PINHOLE"
    is_camera_shared: bool = False
    domain_size_pooling: bool = False
    max_side_px: int | None = None
    batch: bool = False

    def reduced_side(self, height: int, width: int) -> float:
        """Return the length in pixels of the shorter side of the image in which features are detected."""
        scale = min(1.0, (self.max_side_px or COLMAP_SIDE_PX) / max(height, width))
        return scale * min(height, width)

    def options(self, *, is_affine: bool) -> Any:
        """Return pycolmap's options, with or without affine-covariant features."""
        options = pycolmap.FeatureExtractionOptions(use_gpu=False)
        # Neighbouring cameras in a typical ring are at least 18 degrees apart. At such angles, only affine-covariant
        # features match.
        options.sift.estimate_affine_shape = is_affine
        options.sift.domain_size_pooling = is_affine and self.domain_size_pooling
        options.sift.peak_threshold = MIN_CONTRAST
        options.sift.max_num_features = MAX_FEATURES
        if self.max_side_px is not None:
            options.max_image_size = self.max_side_px
        return options


KNOWN_CAMERAS = Extraction(max_side_px=1600, batch=True)
"""Settings for images of cameras that are already known."""


@dataclass(frozen=True)
class Workspace:
    """A folder with images and their COLMAP database.

    The image files have numbers as names, because camera names may contain characters that are invalid in file names.
    """

    folder: Path

    @property
    def images(self) -> Path:
        return self.folder / "images"

    @property
    def database(self) -> Path:
        return self.folder / "database.db"

    def extract_features(
        self,
        pictures: Sequence[Picture],
        settings: Extraction,
        masks: Sequence[Picture] | None = None,
        track: Track = untracked,
    ) -> None:
        """Write RGB images (H, W, 3), detect their features, and write these to the database.

        If ``masks`` (H, W) are given, features are detected only where they are not 0.
        """
        names = [f"{index:06d}.png" for index in range(len(pictures))]
        _write_images(self.images, names, (np.ascontiguousarray(picture[..., ::-1]) for picture in pictures))
        reader = pycolmap.ImageReaderOptions(camera_model=settings.camera_model)
        if masks is not None:
            reader.mask_path = self.folder / "masks"
            _write_images(self.folder / "masks", [f"{name}.png" for name in names], masks)
        mode = pycolmap.CameraMode.SINGLE if settings.is_camera_shared else pycolmap.CameraMode.PER_IMAGE
        smallest = min((settings.reduced_side(*picture.shape[:2]) for picture in pictures), default=0)
        extraction = settings.options(is_affine=smallest >= MIN_AFFINE_SIDE_PX)
        size = core_count() if settings.batch else len(names)
        batches = [names[begin : begin + size] for begin in range(0, len(names), size)]
        for some in track(batches, len(batches), "features"):
            pycolmap.extract_features(self.database, self.images, some, mode, reader, extraction, pycolmap.Device.cpu)

    @contextmanager
    def open(self) -> Iterator[Database]:
        """Open the database."""
        with closing(pycolmap.Database.open(self.database)) as store:
            yield Database(store, sorted(store.read_all_images(), key=lambda image: image.name))


@dataclass(frozen=True, eq=False)
class Database:
    """An open COLMAP database. Images are numbered from 0, in the order in which they were given.

    Attributes:
        store: pycolmap's database.
        images: pycolmap's images.
    """

    store: Any
    images: Sequence[Any]

    def keypoints(self, image: int) -> Array:
        """Read the positions (N, 2), in pixels, of an image's features."""
        return np.asarray(self.store.read_keypoints(self.images[image].image_id), np.float64)[:, :2]

    def features(self, image: int) -> Features:
        """Read the features of an image."""
        descriptors = np.asarray(self.store.read_descriptors(self.images[image].image_id).data, np.float32)
        lengths = np.linalg.norm(descriptors, axis=1, keepdims=True)
        return Features(self.keypoints(image), descriptors / np.maximum(lengths, 1e-9))

    def matches(self, i: int, j: int) -> Indices:
        """Read the index pairs (M, 2) of the matches of two images."""
        return np.asarray(self.store.read_matches(self.images[i].image_id, self.images[j].image_id))

    def write_matches(self, i: int, j: int, matches: Indices, *, verified: bool) -> None:
        """Write the index pairs (M, 2) of the matches of two images. COLMAP verifies matches that are not
        ``verified``."""
        pair = self.images[i].image_id, self.images[j].image_id
        self.store.write_matches(*pair, matches)
        if verified:
            geometry = pycolmap.TwoViewGeometry()
            geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
            geometry.inlier_matches = matches
            self.store.write_two_view_geometry(*pair, geometry)

    def write_pinhole(self, image: int, intrinsics: Array) -> Any:
        """Write the intrinsics (3, 3) of an image's camera, and return pycolmap's camera."""
        lens = self.store.read_camera(self.images[image].camera_id)
        # The values need no conversion: both in COLMAP and in this project, the centre of the first pixel is at (0.5,
        # 0.5).
        lens.params = [intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2]]
        self.store.update_camera(lens)
        return lens

    def replace_features(self, keypoints: Sequence[Array]) -> None:
        """Delete all features and matches, and write the positions (N, 2) of new features of each image."""
        for clear in (self.store.clear_keypoints, self.store.clear_descriptors, self.store.clear_matches):
            clear()
        for image, xy in zip(self.images, keypoints, strict=True):
            self.store.write_keypoints(image.image_id, xy.astype(np.float32))


@contextmanager
def temporary_workspace(prefix: str) -> Iterator[Workspace]:
    """Create a workspace in a temporary folder, and limit COLMAP's log on stderr to errors."""
    logging = pycolmap.logging
    before = logging.minloglevel
    logging.minloglevel = int(logging.ERROR)
    try:
        with tempfile.TemporaryDirectory(prefix=prefix) as folder:
            yield Workspace(Path(folder))
    finally:
        logging.minloglevel = before


def _write_images(folder: Path, names: Sequence[str], pictures: Iterable[Picture]) -> None:
    folder.mkdir(parents=True)
    for name, picture in zip(names, pictures, strict=True):
        if not cv2.imwrite(str(folder / name), picture):
            raise OSError(f"{folder / name}: cannot write this temporary image")
