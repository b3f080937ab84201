"""Random access to the frames of a video by frame number. Frames are not extracted to disk."""

from __future__ import annotations

from contextlib import nullcontext
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.limits import require_regular
from fourd.base.processes.isolation import ParserProcess
from fourd.recording.capture.streams.appearance import look_at
from fourd.recording.capture.streams.container import damaged, open_container, video_stream
from fourd.recording.capture.streams.decoder import Decoder
from fourd.recording.capture.streams.frames import FrameReader
from fourd.recording.capture.streams.index import MAX_FPS, MIN_FPS, VideoIndex, index_from_json, index_to_json
from fourd.recording.capture.streams.interlacing import deinterlace
from fourd.recording.capture.streams.packets import read_packets
from fourd.recording.capture.streams.picture import to_rgb
from fourd.recording.capture.streams.probe import index_by_decoding, index_by_times

__all__ = [
    "MAX_FPS",
    "MIN_FPS",
    "VideoIndex",
    "VideoReader",
    "first_frame",
    "index_from_json",
    "index_to_json",
    "index_video",
    "open_container",
    "video_stream",
]

SECONDS_PER_FRAME = 0.5
"""CPU time in seconds that the child process may use for each frame, if it decodes all frames of a video."""


def index_video(path: Path, parser: ParserProcess | None = None) -> VideoIndex:
    """Create a video's index from its packets, and check it by decoding some frames.

    If the times of the packets do not identify the frames, as in MPEG-TS and AVI files, all frames are decoded. The
    video is read in a child process, because a damaged video can crash FFmpeg.

    Args:
        path: the video.
        parser: the child process to use, or None to start one.

    Raises:
        UserError: if the file is not a video, is truncated or damaged, or has fewer than 2 frames with presentation
            times. UserError is also raised if several frames have the same time, or if the metadata mirrors the frames
            or turns them by an angle that is not a multiple of 90 degrees.
    """
    if not path.is_file():
        raise UserError(f"{path}: expected a video, got no such file; copy the video again")
    require_regular(path)
    with ParserProcess() if parser is None else nullcontext(parser) as process:
        values = process.call("fourd.recording.capture.video:probe_in_child", path).value
        if isinstance(values, int):
            seconds = SECONDS_PER_FRAME * min(values, path.stat().st_size)
            values = process.call("fourd.recording.capture.video:decode_in_child", path, more_seconds=seconds).value
    try:
        return index_from_json(values)
    except ValueError as error:
        raise damaged(path, error) from error


def probe_in_child(name: str) -> dict[str, Any] | int:
    """Create a video's index from its packets. :func:`index_video` calls this in its child process.

    Returns:
        The index as JSON values, or the number of packets if all frames must be decoded.
    """
    path = Path(name)
    try:
        packets = read_packets(path)
        index = index_by_times(path, packets)
    except (av.FFmpegError, OSError, ValueError, OverflowError) as error:
        raise damaged(path, error) from error
    return len(packets) if index is None else index_to_json(index)


def decode_in_child(name: str) -> dict[str, Any]:
    """Create a video's index by decoding all its frames. :func:`index_video` calls this in its child process."""
    path = Path(name)
    try:
        return index_to_json(index_by_decoding(path, read_packets(path)))
    except (av.FFmpegError, OSError, ValueError, OverflowError) as error:
        raise damaged(path, error) from error


class VideoReader:
    """Reads frames of a video by number, see :class:`fourd.recording.capture.streams.frames.FrameReader`.

    Close the reader after use, or use it as a context manager. The reader is not thread-safe.
    """

    def __init__(self, path: Path, index: VideoIndex, threads: int = 0) -> None:
        """Create a reader that decodes with ``threads`` threads. If ``threads`` is 0, FFmpeg chooses the number."""
        self.path = path
        self.index = index
        self._threads = threads
        self._frames = FrameReader(path, index, threads)
        self._last: tuple[int, NDArray[np.uint8]] | None = None

    def __reduce__(self) -> tuple[type[VideoReader], tuple[Path, VideoIndex, int]]:
        """Pickle the reader without its open file. After unpickling, the next read opens the file again."""
        return VideoReader, (self.path, self.index, self._threads)

    def __enter__(self) -> VideoReader:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; the next read opens it again."""
        self._frames.close()

    def read(self, frame: int) -> NDArray[np.uint8]:
        """Decode a frame to RGB (H, W, 3) uint8; the array is read-only.

        Raises:
            UserError: if the video is damaged or ends before the frame.
            ValueError: if the frame number is out of range.
        """
        if not 0 <= frame < self.index.frames:
            raise ValueError(f"frame: expected 0 to {self.index.frames - 1}, got {frame}")
        if self._last is None or self._last[0] != frame:
            try:
                picture = self._picture(frame)
            except (av.FFmpegError, OSError) as error:
                raise damaged(self.path, error) from error
            picture.flags.writeable = False
            self._last = (frame, picture)
        return self._last[1]

    def _picture(self, number: int) -> NDArray[np.uint8]:
        index = self.index
        if index.is_interlaced:
            # Deinterlacing needs the frame before and the frame after.
            numbers = [each for each in (number - 1, number, number + 1) if 0 <= each < index.frames]
            frames = [self._frames.frame(each) for each in numbers]
            at = numbers.index(number)
            whole = deinterlace(frames, at) if frames[at].interlaced_frame else frames[at]
        else:
            whole = self._frames.frame(number)
        return to_rgb(whole, index.turn, index.transfer, index.unturned_size)


def first_frame(path: Path) -> tuple[int, int, int, str]:
    """Return the width and height in pixels of the first frame, stretched to square pixels and upright, the angle in
    degrees that turns it upright, and its HDR transfer function.

    Raises:
        UserError: if no frame can be decoded, or the metadata mirrors the frames or turns them by an angle that is not
            a multiple of 90 degrees.
    """
    with open_container(path) as container:
        stream = video_stream(path, container)
        number, aspect = stream.index, stream.sample_aspect_ratio or Fraction(1)
    decoder = Decoder(path, number, 1, by_packets=False, is_strict=False)
    try:
        for each in decoder.from_start():
            look = look_at(path, each.frame, aspect)
            return *look.size, look.turn, look.transfer
    finally:
        decoder.close()
    raise UserError(f"{path}: expected a video with frames, got no frame that can be decoded; copy the file again")
