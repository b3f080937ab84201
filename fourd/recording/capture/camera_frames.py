"""Access to the decoded frames of one camera, from image files or a video."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from fourd.recording.capture.video import VideoReader

Picture = NDArray[np.uint8]


class CameraFrames(Protocol):
    """Decodes the selected frames of one camera; the argument ``frame`` is an index into this selection."""

    def read(self, frame: int) -> Picture:
        """Decode a frame without undistorting or resizing it.

        Raises:
            UserError: if the frame is damaged.
        """

    def describe(self, frame: int) -> str:
        """Return the words that name the frame in error messages: its file and, in a video, also its frame number."""

    def close(self) -> None:
        """Close open files; the next read opens them again."""


@dataclass(frozen=True)
class PictureFrames:
    """Selected frames that are stored as image files, one file per frame."""

    paths: Sequence[Path]
    decode: Callable[[Path], Picture]

    def read(self, frame: int) -> Picture:
        return self.decode(self.paths[frame])

    def describe(self, frame: int) -> str:
        return str(self.paths[frame])

    def close(self) -> None:
        """Do nothing: image files are open only while they are read."""


@dataclass(frozen=True)
class VideoFrames:
    """Selected frames of a video; ``numbers[i]`` is the number of the selected frame i in the video."""

    reader: VideoReader
    numbers: Sequence[int]

    def read(self, frame: int) -> Picture:
        return self.reader.read(self.numbers[frame])

    def describe(self, frame: int) -> str:
        return f"{self.reader.path} frame {self.numbers[frame]}"

    def close(self) -> None:
        self.reader.close()


@dataclass(frozen=True)
class Mattes:
    """One camera's mattes for the selected frames.

    Attributes:
        frames: the matte files, one per frame.
        is_generated: whether fourd generated the mattes. Generated mattes match the undistorted images, so the reader
            does not undistort them.
    """

    frames: CameraFrames
    is_generated: bool


@dataclass(frozen=True)
class Footage:
    """The selected frames of one camera.

    Attributes:
        images: the camera's images.
        mattes: the camera's mattes, or None if the camera has no mattes.
        size: (width, height) of the stored images in pixels.
    """

    images: CameraFrames
    mattes: Mattes | None
    size: tuple[int, int]
