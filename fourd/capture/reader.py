"""A capture that was opened: cameras, and pictures and mattes decoded when they are asked for."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera
from fourd.capture.calibration import Calibration, read_calibration
from fourd.capture.decoding import decode_matte, decode_rgb, picture_size
from fourd.capture.layout import (
    camera_folders,
    chosen_frames,
    chosen_views,
    frame_order,
    missing_frame,
    pictures,
)
from fourd.errors import UserError

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Files:
    """A camera's files of the selected frames; mattes is empty where the capture has none."""

    images: tuple[Path, ...]
    mattes: tuple[Path, ...]


class Capture:
    """Selected cameras and frames of a multi-view video.

    Pictures and mattes come undistorted and scaled, as ``cameras`` describe them. They are
    decoded when asked for and kept in one cache of bounded size, so that memory does not grow
    with the number of frames. Not for several threads at once.

    Attributes:
        path: the capture's folder.
        names: camera names.
        cameras: pinholes without distortion, in the order of ``names``.
        frame_numbers: positions of the selected frames in the whole capture, from 0.
        total_frames: frames of the whole capture.
    """

    def __init__(
        self,
        path: Path,
        names: Sequence[str],
        lenses: Sequence[Camera],
        files: Sequence[Files],
        frame_numbers: Sequence[int],
        total_frames: int,
        scale: float,
        cache_mb: int,
    ) -> None:
        self.path = path
        self.names = tuple(names)
        self.cameras = tuple(replace(lens, distortion=None).scaled(scale) for lens in lenses)
        self.frame_numbers = tuple(frame_numbers)
        self.total_frames = total_frames
        self._lenses = tuple(lenses)
        self._files = tuple(files)
        self._cache = _Cache(cache_mb << 20)

    @property
    def frame_count(self) -> int:
        """Number of selected frames."""
        return len(self.frame_numbers)

    @property
    def has_masks(self) -> bool:
        """Whether every selected camera has mattes."""
        return all(files.mattes for files in self._files)

    def time(self, frame: int) -> float:
        """Time in [0, 1] of a selected frame within the whole capture: f / (F - 1), 0 when F = 1."""
        return self.frame_numbers[frame] / max(self.total_frames - 1, 1)

    def image(self, camera: int, frame: int) -> Picture:
        """(H, W, 3) uint8 RGB, read-only. Raises UserError when the file is damaged or of another size."""
        path = self._files[camera].images[frame]
        return self._cache.get(path, lambda: self._undistorted(decode_rgb(path), path, camera))

    def mask(self, camera: int, frame: int) -> Picture:
        """(H, W) uint8 matte, 255 = object, read-only. Raises UserError as image, and where there are none."""
        mattes = self._files[camera].mattes
        if not mattes:
            raise UserError(
                f"{self.path / 'masks' / self.names[camera]}: expected mattes (FRAME.png), got none; make them first"
            )
        path = mattes[frame]
        return self._cache.get(path, lambda: self._undistorted(decode_matte(path), path, camera))

    def _undistorted(self, picture: Picture, path: Path, index: int) -> Picture:
        lens, camera = self._lenses[index], self.cameras[index]
        height, width = picture.shape[:2]
        if (width, height) != (lens.width, lens.height):
            raise UserError(
                f"{path}: expected {lens.width} x {lens.height} pixels, as camera '{self.names[index]}' has, "
                f"got {width} x {height}; export it again at that size"
            )
        if lens.distortion is not None:
            maps = self._cache.get(index, lambda: _undistortion(lens))
            picture = np.asarray(cv2.remap(picture, maps[0], maps[1], cv2.INTER_LINEAR), np.uint8)
        if (camera.width, camera.height) != (width, height):
            smaller = camera.width < width
            how = cv2.INTER_AREA if smaller else cv2.INTER_LINEAR
            picture = np.asarray(cv2.resize(picture, (camera.width, camera.height), interpolation=how), np.uint8)
        picture.flags.writeable = False
        return picture


def open_capture(
    path: Path | str,
    *,
    views: Sequence[str] | None = None,
    frames: str | None = None,
    scale: float = 1.0,
    cache_mb: int = 256,
) -> Capture:
    """Open a capture of the EasyMocap layout: images/CAM/FRAME.jpg|png, masks/CAM/FRAME.png, intri.yml, extri.yml.

    No picture is decoded. Lens distortion is taken out of pictures and mattes with the
    intrinsics kept; pixels that the lens did not see are 0.

    Args:
        path: the capture's folder.
        views: names of the cameras to use; None for all.
        frames: ``A:B[:S]``, positions in the capture's order of frames; None for all.
        scale: of the images' size, in (0, 4].
        cache_mb: MiB of decoded pictures to keep at most.

    Raises:
        UserError: one line, when files are missing or contradict each other, or the selection is empty.
    """
    path = Path(path)
    if not 0 < scale <= 4:
        raise UserError(f"--scale: expected a factor above 0 and at most 4, got {scale:g}")
    if not path.is_dir():
        raise UserError(
            f"{path}: expected a capture's folder, got {'a file' if path.exists() else 'nothing there'}; check the path"
        )
    calibrations = read_calibration(path)
    names = _usable_names(path, calibrations, views)
    found = {name: pictures(path / "images" / name) for name in names}
    stems = frame_order(set().union(*found.values()))
    for name in names:
        if not found[name]:
            raise UserError(f"{path / 'images' / name}: expected pictures (FRAME.jpg or .png), got none; restore them")
    selected = chosen_frames(frames, len(stems))
    files = [_files(path, name, found[name], [stems[number] for number in selected]) for name in names]
    for name, of_camera in zip(names, files, strict=True):
        if bool(of_camera.mattes) != bool(files[0].mattes):
            bare = name if not of_camera.mattes else names[0]
            raise UserError(
                f"{path / 'masks' / bare}: expected mattes, as other cameras have them, got none; "
                "add them or leave the camera out with --views"
            )
    lenses = [_lens(path, name, calibrations[name], of.images[0]) for name, of in zip(names, files, strict=True)]
    return Capture(path, names, lenses, files, list(selected), len(stems), scale, cache_mb)


def _usable_names(path: Path, calibrations: dict[str, Calibration], views: Sequence[str] | None) -> list[str]:
    """The selected cameras; every one of them has a calibration and a folder of pictures."""
    folders = camera_folders(path / "images")
    everyone = list(calibrations) + [name for name in folders if name not in calibrations]
    names = chosen_views(views, everyone)
    for name in names:
        if name not in calibrations:
            raise UserError(
                f"{path / 'intri.yml'}: expected camera '{name}', since images/{name} exists, got no such name; "
                "calibrate it or leave it out with --views"
            )
        if name not in folders:
            raise UserError(
                f"{path / 'images' / name}: expected the pictures of camera '{name}' of intri.yml, got no such folder; "
                "restore it or leave it out with --views"
            )
    return names


def _files(path: Path, name: str, images: dict[str, str], stems: list[str]) -> Files:
    folder = path / "images" / name
    error = missing_frame(folder, images, stems)
    if error is not None:
        raise error
    masks_folder = path / "masks" / name
    masks = pictures(masks_folder)
    error = missing_frame(masks_folder, masks, stems) if masks else None
    if error is not None:
        raise error
    mattes = tuple(masks_folder / masks[stem] for stem in stems) if masks else ()
    return Files(tuple(folder / images[stem] for stem in stems), mattes)


def _lens(path: Path, name: str, calibration: Calibration, first: Path) -> Camera:
    """The camera with its distortion; sizes that the calibration lacks are those of the first picture."""
    width, height = calibration.width, calibration.height
    if width is None or height is None:
        width, height = picture_size(first)
    try:
        return calibration.camera(width, height)
    except ValueError as error:
        raise UserError(f"{path / 'intri.yml'}: camera '{name}': {error}; calibrate that camera again") from error


def _undistortion(lens: Camera) -> NDArray[np.float32]:
    """(2, H, W) positions x and y in the distorted picture of an ideal pinhole's pixels, with the same K.

    OpenCV counts pixels from their centres, this project from their corners: half a pixel apart.
    """
    k = lens.intrinsics.copy()
    k[:2, 2] -= 0.5
    size = (lens.width, lens.height)
    return np.stack(cv2.initUndistortRectifyMap(k, lens.distortion, None, k, size, cv2.CV_32FC1)).astype(np.float32)


class _Cache:
    """Arrays by key, the longest unused dropped first, within a budget of bytes (the newest always stays)."""

    def __init__(self, budget: int) -> None:
        self._budget = budget
        self._used = 0
        self._kept: OrderedDict[object, NDArray[Any]] = OrderedDict()

    def get(self, key: object, make: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        array = make()
        self._kept[key] = array
        self._used += array.nbytes
        while self._used > self._budget and len(self._kept) > 1:
            _, dropped = self._kept.popitem(last=False)
            self._used -= dropped.nbytes
        return array
