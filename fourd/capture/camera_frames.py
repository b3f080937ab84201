"""The decoded frames of one camera, from picture files or a video."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fourd.capture.video import VideoReader

Picture = NDArray[np.uint8]


class CameraFrames(Protocol):
    """The selected frames of one camera, by index into the selection."""

    def read(self, frame: int) -> Picture:
        """Decode a frame, pixels as stored. Raises UserError when it is damaged."""

    def describe(self, frame: int) -> str:
        """The file, and the frame within it, for error messages."""


@dataclass(frozen=True)
class PictureFrames:
    """One picture file per frame."""

    paths: Sequence[Path]
    decode: Callable[[Path], Picture]

    def read(self, frame: int) -> Picture:
        return self.decode(self.paths[frame])

    def describe(self, frame: int) -> str:
        return str(self.paths[frame])


@dataclass(frozen=True)
class VideoFrames:
    """Frames of a video; ``numbers`` are the selected frames' numbers in the video."""

    reader: VideoReader
    numbers: Sequence[int]

    def read(self, frame: int) -> Picture:
        return self.reader.read(self.numbers[frame])

    def describe(self, frame: int) -> str:
        return f"{self.reader.path} frame {self.numbers[frame]}"
