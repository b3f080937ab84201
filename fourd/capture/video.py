"""Random access to the frames of a video by frame number. Frames are not extracted to disk."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from fourd.capture.matroska import missing_bytes
from fourd.errors import UserError

MAX_JITTER = 0.25
"""Maximum deviation of a frame's time from a constant frame rate, in frame intervals.

A dropped frame causes a deviation of at least 0.5.
"""


@dataclass(frozen=True)
class VideoIndex:
    """Frame size, frame times and keyframes of a video.

    Attributes:
        width: width of the decoded frames in pixels.
        height: height of the decoded frames in pixels.
        frames: number of frames.
        start: presentation time of frame 0 in seconds.
        fps: frame rate in 1/s.
        keyframes: ascending numbers of the frames that can be decoded without earlier frames.
    """

    width: int
    height: int
    frames: int
    start: Fraction
    fps: Fraction
    keyframes: tuple[int, ...]

    def time(self, frame: int) -> Fraction:
        """Presentation time of a frame in seconds."""
        return self.start + frame / self.fps

    def keyframe_before(self, frame: int) -> int:
        """Number of the last keyframe at or before ``frame``; 0 if there is no such keyframe."""
        count = int(np.searchsorted(self.keyframes, frame, side="right"))
        return self.keyframes[count - 1] if count else 0


def index_video(path: Path) -> VideoIndex:
    """Create a video's index from its packets, and decode the first and the last frame as a check.

    Raises:
        UserError: if the file is not a video, is truncated, or has rotation metadata or a variable frame rate.
    """
    if not path.is_file():
        raise UserError(f"{path}: expected a video, got no such file; copy the video again")
    try:
        with av.open(str(path)) as container:
            if not container.streams.video:
                raise UserError(f"{path}: expected a video, got a file without a video stream; remove the file")
            stream = container.streams.video[0]
            declared = stream.frames
            packets = [(packet.pts, packet.is_keyframe) for packet in container.demux(stream) if packet.pts is not None]
            base = stream.time_base
        if not packets or base is None:
            raise UserError(f"{path}: expected a video with frames, got no frames; copy the file again")
        if len(packets) < declared:
            raise _truncated(path, len(packets), declared)
        missing = missing_bytes(path)
        if missing:
            size = path.stat().st_size
            raise UserError(
                f"{path}: expected {size + missing} bytes according to the file's header, got {size}; copy or record "
                "the video again"
            )
        packets.sort()
        fps = _constant_rate(path, np.array([pts for pts, _ in packets], np.int64), base)
        width, height = _first_size(path)
        keyframes = tuple(number for number, (_, is_key) in enumerate(packets) if is_key)
        index = VideoIndex(width, height, len(packets), packets[0][0] * base, fps, keyframes)
        with VideoReader(path, index) as reader:
            reader.read(len(packets) - 1)
    except (av.FFmpegError, OSError, ValueError) as error:
        raise _damaged(path, error) from error
    return index


class VideoReader:
    """Reads frames of a video by number.

    Reading frames in ascending order decodes each frame once. For other orders, the reader seeks to the last keyframe
    before the requested frame, and decodes all frames from this keyframe. Close the reader after use, or use it as a
    context manager. The reader is not thread-safe.
    """

    def __init__(self, path: Path, index: VideoIndex) -> None:
        self.path = path
        self.index = index
        self._container: av.container.InputContainer | None = None
        self._frames: Iterator[av.VideoFrame] = iter(())
        self._next = 0
        self._last: tuple[int, NDArray[np.uint8]] | None = None

    def __reduce__(self) -> tuple[type[VideoReader], tuple[Path, VideoIndex]]:
        """Pickle the reader without its open file. After unpickling, the next read opens the file again."""
        return VideoReader, (self.path, self.index)

    def __enter__(self) -> VideoReader:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; the next read opens it again."""
        if self._container is not None:
            self._frames = iter(())
            self._container.close()
            self._container = None

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
                picture = self._decode(frame)
            except (av.FFmpegError, OSError) as error:
                raise _damaged(self.path, error) from error
            picture.flags.writeable = False
            self._last = (frame, picture)
        return self._last[1]

    def _decode(self, number: int) -> NDArray[np.uint8]:
        keyframe = self.index.keyframe_before(number)
        if self._container is None or not keyframe <= self._next <= number:
            self._seek(keyframe)
        found = self._decode_until(number)
        if found is None:
            # The seek ended after the requested frame. There are two possible reasons: the frame is stored after a
            # keyframe that is displayed later, or the container seeks beyond the requested time. Decode from the start
            # of the video instead.
            self._seek(0)
            found = self._decode_until(number)
        if found is None:
            raise _truncated(self.path, self._next, self.index.frames)
        return np.asarray(found.to_ndarray(format="rgb24"), np.uint8)

    def _decode_until(self, wanted: int) -> av.VideoFrame | None:
        """Decode frames up to the frame number ``wanted``; return the frame ``wanted``, or None if it is missing."""
        for frame in self._frames:
            if frame.pts is None or frame.time_base is None:
                continue
            number = round((frame.pts * frame.time_base - self.index.start) * self.index.fps)
            self._next = number + 1
            if number >= wanted:
                return frame if number == wanted else None
        return None

    def _seek(self, frame: int) -> None:
        if self._container is None:
            self._container = av.open(str(self.path))
            self._container.streams.video[0].thread_type = "AUTO"
        stream = self._container.streams.video[0]
        assert stream.time_base is not None
        self._container.seek(round(self.index.time(frame) / stream.time_base), stream=stream)
        self._frames = self._container.decode(stream)
        self._next = frame


def _first_size(path: Path) -> tuple[int, int]:
    """Width and height in pixels of the first frame.

    Raises:
        UserError: if the video has rotation metadata or no frame can be decoded.
    """
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            if frame.rotation % 360:
                raise UserError(
                    f"{path}: expected frames stored upright, got rotation metadata of {frame.rotation % 360} degrees; "
                    f"rotate the frames with: ffmpeg -i {path.name} -crf 12 upright-{path.name}"
                )
            return frame.width, frame.height
    raise UserError(f"{path}: expected a video with frames, got no frame that can be decoded; copy the file again")


def _constant_rate(path: Path, pts: NDArray[np.int64], base: Fraction) -> Fraction:
    """Compute the constant frame rate in 1/s from presentation times, which may be rounded to the container's ticks.

    Raises:
        UserError: if the frame rate is not constant.
    """
    if len(pts) == 1:
        return Fraction(1)
    step = Fraction(int(pts[-1] - pts[0]), len(pts) - 1)
    if step <= 0:
        raise UserError(
            f"{path}: expected frames at increasing times, got several frames at the same time; re-encode the video "
            "with ffmpeg"
        )
    jitter = np.abs(pts - pts[0] - np.arange(len(pts)) * float(step)) / float(step)
    if jitter.max() > MAX_JITTER and jitter.max() * float(step) > 1:
        steps = np.diff(pts) * float(base)
        raise UserError(
            f"{path}: expected a constant frame rate, got frame intervals of {1e3 * steps.min():.1f} to "
            f"{1e3 * steps.max():.1f} ms (first deviation at frame {int(np.argmax(jitter > MAX_JITTER))}); re-encode "
            f"the video with: ffmpeg -i {path.name} -fps_mode cfr -crf 12 even-{path.name}"
        )
    return (1 / (step * base)).limit_denominator(1001)


def _truncated(path: Path, got: int, declared: int) -> UserError:
    return UserError(f"{path}: expected {declared} frames, got {got}; copy or record the video again")


def _damaged(path: Path, error: Exception) -> UserError:
    reason = getattr(error, "strerror", None) or str(error)
    return UserError(f"{path}: expected a complete video, got '{reason}'; copy the file again")
