"""Reads time-aligned frames from a source before the capture is written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.recording.capture.camera_frames import CameraFrames, PictureFrames, VideoFrames
from fourd.recording.capture.decoding import decode_rgb, decode_rgb_bytes
from fourd.recording.capture.video import VideoIndex, VideoReader
from fourd.recording.capture.video_list import Video, align_videos
from fourd.recording.importing.imported import EncodedPictures, Frames, ImportedCamera, PictureFiles, video_files

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class EncodedFrames:
    """The frames of one camera, read from encoded images inside a larger file."""

    frames: EncodedPictures

    def read(self, frame: int) -> Picture:
        """Decode a frame to RGB, (H, W, 3) uint8, without undistortion. Raises UserError if the frame is damaged."""
        return decode_rgb_bytes(self.frames.read(frame), self.describe(frame))

    def describe(self, frame: int) -> str:
        """Return the name of a frame for error messages."""
        return f"frame {self.frames.names[frame]}{self.frames.suffix}"

    def close(self) -> None:
        """Do nothing: the file is open only while it is read."""


class SynchronizedFrames:
    """Time-aligned frames of all cameras of a source. Leaving this context manager closes the videos.

    Attributes:
        names: the cameras' names.
        counts: number of frames of each camera, without the frames that the camera's offset skips.
        count: number of frames that all cameras have.
    """

    def __init__(
        self, cameras: tuple[ImportedCamera, ...], indices: Mapping[str, VideoIndex], offsets: Mapping[str, float]
    ) -> None:
        """Open the frames of ``cameras``.

        Args:
            cameras: the source's cameras.
            indices: video indices by camera name.
            offsets: time offsets of the videos in frames of the common clock, which has the lowest frame rate of all
                videos. The keys are camera names, and missing offsets are 0. In a video with the offset n, each event
                appears n frames later than in a video with the offset 0.

        Raises:
            UserError: when there is no frame that all cameras have.
        """
        self.names = tuple(camera.name for camera in cameras)
        videos = align_videos(video_files(cameras), indices, offsets)
        self._stack = ExitStack()
        opened = [self._open_frames(camera.frames, videos.get(camera.name)) for camera in cameras]
        self._sources = tuple(source for source, _ in opened)
        self.counts = tuple(count for _, count in opened)
        self.count = max(0, min(self.counts, default=0))
        if not self.count:
            raise UserError(f"{cameras[0].name}: expected frames that all cameras have, got none; check the offsets")

    def __enter__(self) -> SynchronizedFrames:
        return self

    def __exit__(self, *exception: object) -> None:
        self._stack.close()

    def picture(self, camera: int, frame: int) -> Picture:
        """Read a frame of a camera as RGB, (H, W, 3) uint8, without undistortion."""
        return self._sources[camera].read(frame)

    def pictures(self, frame: int) -> list[Picture]:
        """Read the images of all cameras for one frame number."""
        return [source.read(frame) for source in self._sources]

    def check_sizes(self, numbers: Sequence[int], pictures: Sequence[Sequence[Picture]]) -> None:
        """Raise UserError if a camera's images, read at the frame numbers ``numbers``, do not have the same size."""
        for number, of_frame in zip(numbers, pictures, strict=True):
            for source, name, picture, first in zip(self._sources, self.names, of_frame, pictures[0], strict=True):
                if picture.shape != first.shape:
                    (height, width), (first_height, first_width) = picture.shape[:2], first.shape[:2]
                    raise UserError(
                        f"camera '{name}': {source.describe(number)}: expected {first_width} x {first_height} pixels "
                        f"as in the first frame, got {width} x {height}; export the frames again at one size"
                    )

    def _open_frames(self, frames: Frames, video: Video | None) -> tuple[CameraFrames, int]:
        if isinstance(frames, PictureFiles):
            return PictureFrames(frames.paths, decode_rgb), len(frames.paths)
        if isinstance(frames, EncodedPictures):
            return EncodedFrames(frames), frames.count
        assert video is not None
        reader = self._stack.enter_context(VideoReader(video.path, video.index))
        return VideoFrames(reader, [video.number(frame) for frame in range(video.frames_left)]), video.frames_left
