"""An opened capture with its cameras, images and mattes. Images and mattes are decoded on demand and cached."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from cachetools import LRUCache
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError, command_line
from fourd.base.progress import Log
from fourd.recording.capture.calibration import Calibration, CalibrationReport, require_calibration
from fourd.recording.capture.camera_frames import CameraFrames, Footage, Picture, PictureFrames, VideoFrames
from fourd.recording.capture.decoding import read_header
from fourd.recording.capture.frame_rate import read_rate
from fourd.recording.capture.layout import (
    VIDEOS,
    camera_folders,
    find_videos,
    frame_name,
    parse_frame_range,
    select_views,
)
from fourd.recording.capture.pictures.alpha import resample
from fourd.recording.capture.pictures.footage import open_masks, open_mattes, open_pictures, picture_frame_names
from fourd.recording.capture.pictures.listing import list_images
from fourd.recording.capture.pictures.orientation import check_turned
from fourd.recording.capture.video import VideoReader
from fourd.recording.capture.video_list import Video, common_frames, common_rate, list_videos


class Capture:
    """Selected cameras and frames of a multi-view video.

    Use the object as a context manager, or call :meth:`close`, because videos keep files and threads open.

    Images and mattes are decoded on demand, then undistorted and scaled to match ``cameras``. A cache of limited size
    keeps them, so that memory does not grow with the number of frames. The class is not thread-safe.

    Attributes:
        path: the capture's folder.
        names: camera names.
        cameras: pinhole cameras without distortion, in the order of ``names``.
        frame_names: names of the selected frames. A frame's name is the name of its image file without suffix.
        frame_numbers: indices of the selected frames in the whole capture.
        total_frames: number of frames of the whole capture.
        time_span: range of frame indices in the whole capture, over which the time runs from 0 to 1. By default, it
            contains all frames.
        fps: number of selected frames per second of the recording, or None if the frame rate is not known. If every
            S-th frame is selected, ``fps`` is the recording's frame rate divided by S.
        metres_per_unit: length of a world unit in metres, or None if the calibration does not state it.
    """

    def __init__(
        self,
        path: Path,
        names: Sequence[str],
        distorted_cameras: Sequence[Camera],
        footage: Sequence[Footage],
        frame_names: Sequence[str],
        frame_numbers: Sequence[int],
        total_frames: int,
        scale: float,
        cache_mb: int,
        cache_frames: int = 0,
        fps: float | None = None,
        metres_per_unit: float | None = None,
    ) -> None:
        self.path = path
        self.names = tuple(names)
        self.cameras = tuple(replace(camera, distortion=None).rescale(scale) for camera in distorted_cameras)
        self.frame_names = tuple(frame_names)
        self.frame_numbers = tuple(frame_numbers)
        self.total_frames = total_frames
        self.time_span = range(total_frames)
        self.fps = fps
        self.metres_per_unit = metres_per_unit
        self._distorted_cameras = tuple(distorted_cameras)
        self._footage = tuple(footage)
        frame_bytes = sum(3 * camera.width * camera.height for camera in self.cameras)
        self._cache = _ArrayCache((cache_mb << 20) + cache_frames * frame_bytes)

    def __enter__(self) -> Capture:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close all videos; the next read opens them again."""
        for footage in self._footage:
            footage.images.close()

    @property
    def distorted_cameras(self) -> tuple[Camera, ...]:
        """The cameras of the stored images, at full size and with distortion."""
        return self._distorted_cameras

    def with_cameras(self, cameras: Sequence[Camera]) -> Capture:
        """Return a copy with the pinhole cameras ``cameras``, one for each of ``names``. The images do not change."""
        other = copy(self)
        other.cameras = tuple(cameras)
        return other

    def with_time_span(self, span: range) -> Capture:
        """Return a copy whose time runs from 0 to 1 over the frames ``span``. They must include all selected frames."""
        other = copy(self)
        other.time_span = span
        return other

    @property
    def frame_count(self) -> int:
        """Number of selected frames."""
        return len(self.frame_numbers)

    @property
    def has_masks(self) -> bool:
        """Whether every selected camera has mattes."""
        return len(self.masked) == len(self.names)

    @property
    def masked(self) -> list[int]:
        """Indices of the cameras that have mattes."""
        return [index for index, footage in enumerate(self._footage) if footage.mattes is not None]

    @property
    def generated(self) -> list[int]:
        """Indices of the cameras whose mattes fourd has generated."""
        mattes = [footage.mattes for footage in self._footage]
        return [index for index, each in enumerate(mattes) if each is not None and each.is_generated]

    def with_mattes(self, log: Log) -> Capture:
        """Return the capture without the cameras that have no mattes, whose names are logged.

        Raises:
            UserError: if fewer than two cameras have mattes.
        """
        masked = self.masked
        if len(masked) < min(2, len(self.names)):
            got = "those of 1 camera" if masked else "none"
            raise UserError(
                f"{self.path}: expected masks/CAM/FRAME.png or mattes, got {got}; "
                f"make mattes with: {command_line('fourd', 'matte', self.path)}"
            )
        if len(masked) == len(self.names):
            return self
        unused = [name for index, name in enumerate(self.names) if index not in masked]
        log(f"{self.path}: not used, because these cameras have no mattes: {', '.join(unused)}")
        return self.select(masked)

    def select(self, indices: Sequence[int]) -> Capture:
        """Return the capture with only the cameras ``indices``."""
        other = copy(self)
        other.names = tuple(self.names[index] for index in indices)
        other.cameras = tuple(self.cameras[index] for index in indices)
        other._distorted_cameras = tuple(self._distorted_cameras[index] for index in indices)
        other._footage = tuple(self._footage[index] for index in indices)
        other._cache = self._cache.empty_copy()
        return other

    def time(self, frame: int) -> float:
        """Return the time of a selected frame, in [0, 1]. If the frame is number f, counted from 0, of the F frames in
        ``time_span``, its time is f / max(F - 1, 1)."""
        return (self.frame_numbers[frame] - self.time_span.start) / max(len(self.time_span) - 1, 1)

    def image(self, camera: int, frame: int) -> Picture:
        """Return the undistorted RGB image (H, W, 3) uint8 of a camera and frame; the array is read-only.

        Raises:
            UserError: if the file is damaged, or the stored image does not have the camera's image size.
        """
        frames = self._footage[camera].images
        return self._cache.get(("image", camera, frame), lambda: self._read(frames, camera, frame))

    def mask(self, camera: int, frame: int) -> Picture:
        """Return the undistorted matte (H, W) uint8 of a camera and frame; 255 is the object. The array is read-only.

        Raises:
            UserError: if there are no mattes, the file is damaged, or the stored matte does not have the camera's
                image size.
        """
        mattes = self._footage[camera].mattes
        if mattes is None:
            raise UserError(
                f"{self.path / 'masks' / self.names[camera]}: expected mattes (FRAME.png), got none; "
                f"make them with: {command_line('fourd', 'matte', self.path)}"
            )
        return self._cache.get(
            ("matte", camera, frame), lambda: self._read(mattes.frames, camera, frame, mattes.is_generated)
        )

    def _read(self, frames: CameraFrames, index: int, frame: int, is_undistorted: bool = False) -> Picture:
        picture = frames.read(frame)
        distorted, camera = self._distorted_cameras[index], self.cameras[index]
        height, width = picture.shape[:2]
        if (width, height) != (distorted.width, distorted.height):
            raise UserError(
                f"{frames.describe(frame)}: expected {distorted.width} x {distorted.height} pixels like camera "
                f"'{self.names[index]}', got {width} x {height}; export the frame again at the expected size"
            )
        maps = None
        if distorted.distortion is not None and not is_undistorted:
            maps = self._cache.get(index, lambda: undistortion_maps(distorted))
        picture = resample(picture, maps, (camera.width, camera.height))
        picture.flags.writeable = False
        return picture


def open_capture(
    path: Path | str,
    *,
    views: Sequence[str] | None = None,
    frames: str | None = None,
    scale: float = 1.0,
    cache_mb: int = 256,
    cache_frames: int = 0,
    mattes: bool = True,
    partial_mattes: bool = False,
) -> Capture:
    """Open a capture in the EasyMocap layout: images/CAM/FRAME.jpg or .png, masks/CAM/FRAME.png, intri.yml, extri.yml.

    If images/ has no camera folders, frames are read from videos/CAM.mp4 (or another video suffix) by seeking. Opening
    a capture decodes images only if they have alpha channels. If masks/ has no mattes of a camera, its mattes are the
    alpha channels of its images, or else the generated mattes. Images are turned upright as their EXIF orientation
    says. Undistortion keeps the intrinsics K. Pixels that the stored image does not cover are 0.

    Args:
        path: the capture's folder.
        views: names of the cameras to use, or None for all cameras.
        frames: frame range ``A:B[:S]`` of indices in the sorted list of frames, or None for all frames.
        scale: factor in (0, 4] by which images are resized.
        cache_mb: size of the cache of decoded images in MiB.
        cache_frames: number of frames, with one image per camera, that the cache can hold in addition to ``cache_mb``.
        mattes: whether to open mattes. A camera needs none, or needs them for all selected frames.
        partial_mattes: whether generated mattes that lack some of the selected frames count as no mattes.

    Raises:
        UserError: if files are missing or inconsistent, or the selection is empty.
    """
    path = Path(path)
    if not 0 < scale <= 4:
        raise UserError(f"--scale: expected a factor above 0 and at most 4, got {scale:g}")
    if not path.is_dir():
        got = "a file" if path.exists() else "no such folder"
        raise UserError(f"{path}: expected a capture's folder, got {got}; check the path")
    report = require_calibration(path)
    names, calibrations = _select_cameras(path, report, views), report.calibrations
    if camera_folders(path / "images"):
        images, rate = list_images(path / "images", names), read_rate(path)
        all_frames = picture_frame_names(path, images)
        selected = parse_frame_range(frames, len(all_frames))
        chosen = [all_frames[number] for number in selected]
        footage = [open_pictures(path, name, images[name], chosen) for name in names]
    else:
        videos = list_videos(path, names)
        all_frames, rate = _list_video_frames(path, videos), common_rate(videos)
        selected = parse_frame_range(frames, len(all_frames))
        chosen = [all_frames[number] for number in selected]
        footage = [_open_video(videos[name], selected) for name in names]
    if mattes:
        footage = _with_mattes(path, names, footage, all_frames, chosen, partial_mattes)
    cameras = [_to_camera(path, name, calibrations[name], of) for name, of in zip(names, footage, strict=True)]
    fps, count = None if rate is None else float(rate / selected.step), len(all_frames)
    unit, indices = report.metres_per_unit, list(selected)
    return Capture(path, names, cameras, footage, chosen, indices, count, scale, cache_mb, cache_frames, fps, unit)


def _with_mattes(
    path: Path, names: Sequence[str], footage: Sequence[Footage], frames: list[str], chosen: list[str], partial: bool
) -> list[Footage]:
    """Add the mattes of the frames ``chosen`` to the footage of each camera. ``frames`` are all frames of the capture.
    If ``partial`` is true, generated mattes that lack some of the frames count as no mattes."""
    own = open_masks(path, frames)
    return [
        replace(of, mattes=open_mattes(path, name, of.images, own, chosen, partial))
        for name, of in zip(names, footage, strict=True)
    ]


def _list_video_frames(path: Path, videos: Mapping[str, Video]) -> list[str]:
    """Return the names of the frames that exist in all videos."""
    total = common_frames(videos)
    if total < 1:
        raise UserError(
            f"{path / VIDEOS}: expected at least one frame that all videos have, got none; import again with other "
            "--offset values"
        )
    return [frame_name(number) for number in range(total)]


def _open_video(video: Video, selected: range) -> Footage:
    numbers = [video.number(number) for number in selected]
    images = VideoFrames(VideoReader(video.path, video.index), numbers)
    return Footage(images, None, (video.index.width, video.index.height))


def _select_cameras(path: Path, calibration: CalibrationReport, views: Sequence[str] | None) -> list[str]:
    """Return the names of the selected cameras, without those of which one calibration file has no values.

    Raises:
        UserError: if a selected camera has no calibration, or has no images and no video.
    """
    found = camera_folders(path / "images")
    folder = "images"
    if not found and (path / VIDEOS).is_dir():
        found, folder = list(find_videos(path / VIDEOS)), VIDEOS
    calibrations, left_out = calibration.calibrations, calibration.incomplete
    names = select_views(views, [*calibrations, *(name for name in found if name not in {**calibrations, **left_out})])
    for name in names:
        if name not in calibrations:
            raise UserError(
                f"{path / 'intri.yml'}: expected camera '{name}', since {folder}/{name} exists, got no such name; "
                "calibrate the camera or exclude it with --views"
            )
        if name not in found:
            raise UserError(
                f"{path / folder / name}: expected images of camera '{name}', which is in intri.yml, got none; "
                "restore them or exclude the camera with --views"
            )
    return names


def _to_camera(path: Path, name: str, calibration: Calibration, footage: Footage) -> Camera:
    """Create the camera with distortion. Its image size is that of ``footage`` if the calibration contains none.

    Raises:
        UserError: if the calibration is not valid, or belongs to images that are not turned upright.
    """
    width, height = calibration.width, calibration.height
    if width is None or height is None:
        width, height = footage.size
    try:
        camera = calibration.camera(width, height)
    except ValueError as error:
        raise UserError(f"{path / 'intri.yml'}: camera '{name}': {error}; calibrate that camera again") from error
    if isinstance(footage.images, PictureFrames):
        first = footage.images.paths[0]
        check_turned(name, camera, first, read_header(first))
    return camera


def undistortion_maps(camera: Camera) -> NDArray[np.float32]:
    """Return, for each pixel of the undistorted image, its position (x, y) in the distorted image: an array (2, H, W).

    The positions follow OpenCV's convention: the centre of the first pixel has the coordinate 0. In fourd, this centre
    has the coordinate 0.5, so the principal point is shifted by half a pixel.
    """
    k = camera.intrinsics.copy()
    k[:2, 2] -= 0.5
    size = (camera.width, camera.height)
    return np.stack(cv2.initUndistortRectifyMap(k, camera.distortion, None, k, size, cv2.CV_32FC1)).astype(np.float32)


class _ArrayCache:
    """Cache of arrays by key, with a limited total size in bytes. The least recently used array is evicted first."""

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._arrays: LRUCache[object, NDArray[Any]] = LRUCache(max_bytes, getsizeof=lambda array: array.nbytes)

    def empty_copy(self) -> _ArrayCache:
        """Return an empty cache of the same size."""
        return _ArrayCache(self._max_bytes)

    def __reduce__(self) -> tuple[type[_ArrayCache], tuple[int]]:
        """Pickle the cache without its arrays, so that other processes do not receive the arrays."""
        return _ArrayCache, (self._max_bytes,)

    def get(self, key: object, make: Callable[[], NDArray[Any]]) -> NDArray[Any]:
        """Return the cached array, or make it and cache it. An array larger than the whole cache is not cached."""
        if key in self._arrays:
            return self._arrays[key]
        array = make()
        if array.nbytes <= self._max_bytes:
            self._arrays[key] = array
        return array
