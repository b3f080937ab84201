"""The result of every importer: cameras in fourd's conventions and the locations of their frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from fourd.base.cameras import Camera
from fourd.recording.capture.layout import frame_name


@dataclass(frozen=True)
class PictureFiles:
    """One image file per frame, in frame order.

    Attributes:
        paths: the files.
        given_names: names of the frames, or None if the names of the files, without suffix, are the names of the
            frames. The images of different cameras are paired by these names; see
            :func:`fourd.recording.importing.pictures.moments.align_pictures`.
    """

    paths: tuple[Path, ...]
    given_names: tuple[str, ...] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the frames."""
        return tuple(path.stem for path in self.paths) if self.given_names is None else self.given_names


@dataclass(frozen=True)
class VideoFile:
    """One video. If it has no offset, frame n of the video is frame n of the capture."""

    path: Path


@dataclass(frozen=True)
class EncodedPictures:
    """Encoded images that are stored inside one larger file, such as HDF5.

    Attributes:
        count: number of frames.
        suffix: suffix of the files to write, such as ``.jpg``.
        read: function that returns the encoded bytes of a frame by index.
        given_names: names of the frames, or None if the frames are named after their indices. The images of different
            cameras are paired by these names.
    """

    count: int
    suffix: str
    read: Callable[[int], bytes]
    given_names: tuple[str, ...] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the frames."""
        return tuple(frame_name(index) for index in range(self.count)) if self.given_names is None else self.given_names


Frames = PictureFiles | VideoFile | EncodedPictures


@dataclass(frozen=True)
class ImportedCamera:
    """One camera of a source.

    Attributes:
        name: name that is unique in the source and valid; see
            :func:`fourd.recording.capture.calibration.camera_name_problem`.
        calibration: pose, intrinsics and distortion with OpenCV axes, in metres if the source is metric. Its width and
            height are the image size at calibration. None if the source has no calibration.
        frames: the images.
        masks: mattes, 255 = object, one per frame, or None if the source has no mattes.
    """

    name: str
    calibration: Camera | None
    frames: Frames
    masks: PictureFiles | EncodedPictures | None = None


@dataclass(frozen=True)
class Imported:
    """The content of a source, without decoded images.

    Attributes:
        cameras: at least one camera, in the order of the source.
        notes: lines of information for the user on units, on axes, and on cameras that are not imported.
        fps: frame rate of the images in 1/s, or None if it is not known or the cameras have videos.
        metres_per_unit: length of a world unit of the calibrations in metres, or None if it is not known.
        test_views: names of the cameras that training holds out by default, the recording's own test split.
    """

    cameras: tuple[ImportedCamera, ...]
    notes: tuple[str, ...]
    fps: Fraction | None = None
    test_views: tuple[str, ...] = ()
    metres_per_unit: float | None = None


def video_files(cameras: Iterable[ImportedCamera]) -> dict[str, Path]:
    """Return the paths of the videos, keyed by camera name. Cameras without a video are left out."""
    return {camera.name: camera.frames.path for camera in cameras if isinstance(camera.frames, VideoFile)}
