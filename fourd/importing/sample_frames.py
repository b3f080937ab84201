"""Single frames of an import's cameras, before they are a capture."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.capture.camera_frames import CameraFrames, PictureFrames, VideoFrames
from fourd.capture.decoding import decode_rgb, decode_rgb_bytes
from fourd.capture.video import VideoIndex, VideoReader
from fourd.capture.video_list import aligned
from fourd.errors import UserError
from fourd.importing.formats.imported import EncodedPictures, Frames, ImportedCamera, PictureFiles

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class EncodedFrames:
    """Pictures that lie encoded within another file."""

    frames: EncodedPictures

    def read(self, frame: int) -> Picture:
        """(H, W, 3) uint8 RGB, as stored. Raises UserError unless it is a whole JPEG or PNG."""
        return decode_rgb_bytes(self.frames.read(frame), self.describe(frame))

    def describe(self, frame: int) -> str:
        """What to name in a message about a frame."""
        return f"frame {frame}{self.frames.suffix}"


class Moments:
    """The frames that all cameras of an import have, by number; a context, which closes the videos.

    Attributes:
        names: of the cameras.
        count: number of frames that all cameras have, after the offsets.
    """

    def __init__(
        self, cameras: tuple[ImportedCamera, ...], indices: Mapping[str, VideoIndex], offsets: Mapping[str, int]
    ) -> None:
        """Open the cameras' frames; ``indices`` are the videos', ``offsets`` those by which these run late.

        Raises:
            UserError: when there is no frame that all cameras have.
        """
        self.names = tuple(camera.name for camera in cameras)
        late = aligned({name: offsets.get(name, 0) for name in indices})
        self._open = ExitStack()
        opened = [self._opened(camera.frames, indices.get(camera.name), late.get(camera.name, 0)) for camera in cameras]
        self._sources = tuple(source for source, _ in opened)
        self.counts = tuple(count for _, count in opened)
        self.count = max(0, min(self.counts, default=0))
        if not self.count:
            raise UserError(f"{cameras[0].name}: expected a frame that all cameras have, got none; look at the offsets")

    def __enter__(self) -> Moments:
        return self

    def __exit__(self, *exception: object) -> None:
        self._open.close()

    def picture(self, camera: int, frame: int) -> Picture:
        """(H, W, 3) uint8 RGB of a camera's frame, as stored."""
        return self._sources[camera].read(frame)

    def pictures(self, frame: int) -> list[Picture]:
        """The pictures of all cameras at one frame."""
        return [source.read(frame) for source in self._sources]

    def _opened(self, frames: Frames, index: VideoIndex | None, late: int) -> tuple[CameraFrames, int]:
        if isinstance(frames, PictureFiles):
            return PictureFrames(frames.paths, decode_rgb), len(frames.paths)
        if isinstance(frames, EncodedPictures):
            return EncodedFrames(frames), frames.count
        assert index is not None
        reader = self._open.enter_context(VideoReader(frames.path, index))
        return VideoFrames(reader, range(late, index.frames)), index.frames - late
