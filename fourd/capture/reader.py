"""A capture that was opened: cameras, and pictures and mattes decoded when they are asked for."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera
from fourd.capture.calibration import Calibration, read_calibration
from fourd.capture.camera_frames import CameraFrames, Picture, PictureFrames, VideoFrames
from fourd.capture.decoding import decode_matte, decode_rgb, picture_size
from fourd.capture.layout import (
    MATTES,
    VIDEOS,
    camera_folders,
    find_pictures,
    find_videos,
    frame_name,
    frame_order,
    missing_frame,
    parse_frame_range,
    select_views,
)
from fourd.capture.video import VideoReader
from fourd.capture.video_list import Video, common_frames, list_videos
from fourd.errors import UserError


@dataclass(frozen=True)
class Mattes:
    """A camera's mattes of the selected frames.

    Attributes:
        source: one file a frame.
        made: whether fourd made them: these hold the pixels of the undistorted pictures.
    """

    frames: CameraFrames
    is_generated: bool


@dataclass(frozen=True)
class Footage:
    """A camera's selected frames; mattes is None where the capture has none of it."""

    images: CameraFrames
    mattes: Mattes | None
    size: tuple[int, int]


class Capture:
    """Selected cameras and frames of a multi-view video.

    Pictures and mattes come undistorted and scaled, as ``cameras`` describe them. They are
    decoded when asked for and kept in one cache of bounded size, so that memory does not grow
    with the number of frames. Not for several threads at once.

    Attributes:
        path: the capture's folder.
        names: camera names.
        cameras: pinholes without distortion, in the order of ``names``.
        frame_names: names of the selected frames, which are their files' without suffix.
        frame_numbers: positions of the selected frames in the whole capture, from 0.
        total_frames: frames of the whole capture.
    """

    def __init__(
        self,
        path: Path,
        names: Sequence[str],
        lenses: Sequence[Camera],
        footage: Sequence[Footage],
        frame_names: Sequence[str],
        frame_numbers: Sequence[int],
        total_frames: int,
        scale: float,
        cache_mb: int,
        cache_frames: int = 0,
    ) -> None:
        self.path = path
        self.names = tuple(names)
        self.cameras = tuple(replace(lens, distortion=None).rescale(scale) for lens in lenses)
        self.frame_names = tuple(frame_names)
        self.frame_numbers = tuple(frame_numbers)
        self.total_frames = total_frames
        self._lenses = tuple(lenses)
        self._footage = tuple(footage)
        frame_bytes = sum(3 * camera.width * camera.height for camera in self.cameras)
        self._cache = _Cache((cache_mb << 20) + cache_frames * frame_bytes)

    @property
    def distorted_cameras(self) -> tuple[Camera, ...]:
        """The cameras as the files' pictures have them: at full size, with distortion."""
        return self._lenses

    def with_cameras(self, cameras: Sequence[Camera]) -> Capture:
        """The same pictures with other ``cameras`` said to have taken them: pinholes, one for each of ``names``."""
        other = copy(self)
        other.cameras = tuple(cameras)
        return other

    @property
    def frame_count(self) -> int:
        """Number of selected frames."""
        return len(self.frame_numbers)

    @property
    def has_masks(self) -> bool:
        """Whether every selected camera has mattes."""
        return all(footage.mattes is not None for footage in self._footage)

    def time(self, frame: int) -> float:
        """Time in [0, 1] of a selected frame within the whole capture: f / (F - 1), 0 when F = 1."""
        return self.frame_numbers[frame] / max(self.total_frames - 1, 1)

    def image(self, camera: int, frame: int) -> Picture:
        """(H, W, 3) uint8 RGB, read-only. Raises UserError when the file is damaged or of another size."""
        source = self._footage[camera].images
        return self._cache.get(("image", camera, frame), lambda: self._pinhole(source, camera, frame))

    def mask(self, camera: int, frame: int) -> Picture:
        """(H, W) uint8 matte, 255 = object, read-only. Raises UserError as image, and where there are none."""
        mattes = self._footage[camera].mattes
        if mattes is None:
            raise UserError(
                f"{self.path / 'masks' / self.names[camera]}: expected mattes (FRAME.png), got none; "
                f"make them: fourd matte {self.path}"
            )
        return self._cache.get(
            ("matte", camera, frame), lambda: self._pinhole(mattes.frames, camera, frame, mattes.is_generated)
        )

    def _pinhole(self, source: CameraFrames, index: int, frame: int, undistorted: bool = False) -> Picture:
        picture = source.read(frame)
        lens, camera = self._lenses[index], self.cameras[index]
        height, width = picture.shape[:2]
        if (width, height) != (lens.width, lens.height):
            raise UserError(
                f"{source.describe(frame)}: expected {lens.width} x {lens.height} pixels, as camera "
                f"'{self.names[index]}' has, got {width} x {height}; export it again at that size"
            )
        if lens.distortion is not None and not undistorted:
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
    cache_frames: int = 0,
    mattes: bool = True,
) -> Capture:
    """Open a capture of the EasyMocap layout: images/CAM/FRAME.jpg|png, masks/CAM/FRAME.png, intri.yml, extri.yml.

    Where there is no images/, the frames are those of videos/CAM.mp4 (or another suffix), read by seeking.
    No picture is decoded here. Mattes that fourd made stand in where masks/ has none.
    Lens distortion is taken out of pictures and mattes with the intrinsics kept; what the lens did not see is 0.

    Args:
        path: the capture's folder.
        views: names of the cameras to use; None for all.
        frames: ``A:B[:S]``, positions in the capture's order of frames; None for all.
        scale: of the images' size, in (0, 4].
        cache_mb: MiB of decoded pictures to keep at most.
        cache_frames: pictures of so many frames of all cameras that are kept beyond these.
        mattes: whether to look for mattes, which must then be whole.

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
    if camera_folders(path / "images"):
        stems = _picture_frames(path, names)
        selected = parse_frame_range(frames, len(stems))
        chosen = [stems[number] for number in selected]
        footage = [_of_pictures(path, name, chosen) for name in names]
    else:
        videos = list_videos(path, names)
        stems = _video_frames(path, videos)
        selected = parse_frame_range(frames, len(stems))
        chosen = [stems[number] for number in selected]
        footage = [_of_video(videos[name], selected) for name in names]
    if mattes:
        footage = [replace(of, mattes=_mattes(path, name, chosen)) for name, of in zip(names, footage, strict=True)]
    for name, of_camera in zip(names, footage, strict=True):
        if (of_camera.mattes is None) != (footage[0].mattes is None):
            bare = name if of_camera.mattes is None else names[0]
            raise UserError(
                f"{path / 'masks' / bare}: expected mattes, as other cameras have them, got none; "
                "add them or leave the camera out with --views"
            )
    lenses = [_lens(path, name, calibrations[name], of.size) for name, of in zip(names, footage, strict=True)]
    return Capture(path, names, lenses, footage, chosen, list(selected), len(stems), scale, cache_mb, cache_frames)


def _picture_frames(path: Path, names: Sequence[str]) -> list[str]:
    """Names of all frames that any camera has a picture of, in order."""
    found = {name: find_pictures(path / "images" / name) for name in names}
    for name in names:
        if not found[name]:
            raise UserError(f"{path / 'images' / name}: expected pictures (FRAME.jpg or .png), got none; restore them")
    return frame_order(set().union(*found.values()))


def _of_pictures(path: Path, name: str, chosen: Sequence[str]) -> Footage:
    folder = path / "images" / name
    found = find_pictures(folder)
    error = missing_frame(folder, found, chosen)
    if error is not None:
        raise error
    images = [folder / found[stem] for stem in chosen]
    return Footage(PictureFrames(images, decode_rgb), None, picture_size(images[0]))


def _video_frames(path: Path, videos: Mapping[str, Video]) -> list[str]:
    """Names of all frames that every video has."""
    total = common_frames(videos)
    if total < 1:
        raise UserError(f"{path / VIDEOS}: expected videos with frames in common, got none; import with other offsets")
    return [frame_name(number) for number in range(total)]


def _of_video(video: Video, selected: range) -> Footage:
    numbers = [number + video.offset for number in selected]
    images = VideoFrames(VideoReader(video.path, video.index), numbers)
    return Footage(images, None, (video.index.width, video.index.height))


def _mattes(path: Path, name: str, chosen: Sequence[str]) -> Mattes | None:
    """The user's mattes of the chosen frames, or else those that fourd made."""
    for folder, made in ((path / "masks" / name, False), (path / MATTES / name, True)):
        files = find_pictures(folder)
        if files:
            error = missing_frame(folder, files, chosen)
            if error is not None and made:
                count = sum(stem in files for stem in chosen)
                raise UserError(
                    f"{folder}: expected mattes of {len(chosen)} frames, got {count}; go on: fourd matte {path}"
                ) from error
            if error is not None:
                raise error
            return Mattes(PictureFrames([folder / files[stem] for stem in chosen], decode_matte), made)
    return None


def _usable_names(path: Path, calibrations: dict[str, Calibration], views: Sequence[str] | None) -> list[str]:
    """The selected cameras; every one of them has a calibration and a folder of pictures."""
    folders = camera_folders(path / "images")
    place = "images"
    if not folders and (path / VIDEOS).is_dir():
        folders, place = list(find_videos(path / VIDEOS)), VIDEOS
    everyone = list(calibrations) + [name for name in folders if name not in calibrations]
    names = select_views(views, everyone)
    for name in names:
        if name not in calibrations:
            raise UserError(
                f"{path / 'intri.yml'}: expected camera '{name}', since {place}/{name} exists, got no such name; "
                "calibrate it or leave it out with --views"
            )
        if name not in folders:
            raise UserError(
                f"{path / place / name}: expected the pictures of camera '{name}' of intri.yml, got none there; "
                "restore them or leave the camera out with --views"
            )
    return names


def _lens(path: Path, name: str, calibration: Calibration, size: tuple[int, int]) -> Camera:
    """The camera with its distortion; ``size`` of its pictures stands in where the calibration says none."""
    width, height = calibration.width, calibration.height
    if width is None or height is None:
        width, height = size
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

    def __reduce__(self) -> tuple[type[_Cache], tuple[int]]:
        """Another process fills its own."""
        return _Cache, (self._budget,)

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
