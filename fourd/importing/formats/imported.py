"""What every importer returns: cameras in this project's conventions, and where their frames lie."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from fourd.cameras import Camera


@dataclass(frozen=True)
class PictureFiles:
    """One JPEG or PNG file a frame, in order."""

    paths: tuple[Path, ...]


@dataclass(frozen=True)
class VideoFile:
    """One video, of which frame n is the capture's frame n until offsets are set."""

    path: Path


@dataclass(frozen=True)
class EncodedPictures:
    """Pictures that lie encoded within another file.

    Attributes:
        count: number of frames.
        suffix: of the files to write, such as ``.jpg``.
        read: bytes of the frame of that position, as they are to be written.
    """

    count: int
    suffix: str
    read: Callable[[int], bytes]


Frames = PictureFiles | VideoFile | EncodedPictures


@dataclass(frozen=True)
class ImportedCamera:
    """One camera of a source.

    Attributes:
        name: unique within the source; letters, digits, ``_``, ``-`` and ``.``.
        lens: pose and intrinsics with distortion, OpenCV axes, lengths as in the written capture
            (metres where the source is metric); its width and height are those that the calibration was made
            for. None where the source has no calibration.
        frames: the pictures.
        masks: mattes, 255 = object, as many as frames; None where the source has none.
    """

    name: str
    lens: Camera | None
    frames: Frames
    masks: PictureFiles | EncodedPictures | None = None


@dataclass(frozen=True)
class Imported:
    """A source as read: no picture is decoded.

    Attributes:
        cameras: in the source's order; at least one.
        notes: what a person should know, a line each: units, axes, what was left out.
    """

    cameras: tuple[ImportedCamera, ...]
    notes: tuple[str, ...]


def video_files(cameras: Iterable[ImportedCamera]) -> dict[str, Path]:
    """The videos of the cameras that have one, by name."""
    return {camera.name: camera.frames.path for camera in cameras if isinstance(camera.frames, VideoFile)}
