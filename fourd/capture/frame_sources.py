"""Where a camera's frames come from: files of pictures, or a video."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from fourd.capture.video import VideoReader

Picture = NDArray[np.uint8]


class FrameSource(Protocol):
    """The selected frames of one camera, by position."""

    def read(self, frame: int) -> Picture:
        """The decoded frame, as stored. Raises UserError when it is damaged."""

    def place(self, frame: int) -> str:
        """What to name in a message about a frame."""


@dataclass(frozen=True)
class PictureSource:
    """A file a frame."""

    paths: Sequence[Path]
    decode: Callable[[Path], Picture]

    def read(self, frame: int) -> Picture:
        return self.decode(self.paths[frame])

    def place(self, frame: int) -> str:
        return str(self.paths[frame])


@dataclass(frozen=True)
class VideoSource:
    """Frames of a video; ``numbers`` are the selected frames' numbers in it."""

    reader: VideoReader
    numbers: Sequence[int]

    def read(self, frame: int) -> Picture:
        return self.reader.read(self.numbers[frame])

    def place(self, frame: int) -> str:
        return f"{self.reader.path} frame {self.numbers[frame]}"
