"""Random access to a video's frames by number, by seeking; nothing is unpacked to disk."""

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
"""Largest deviation from a constant frame rate, in frame intervals. A dropped frame gives at least 0.5."""


@dataclass(frozen=True)
class VideoIndex:
    """Times and keyframes of a video.

    Attributes:
        width, height: of the decoded frames, in pixels.
        frames: number of frames.
        start: presentation time of frame 0, seconds.
        fps: frames per second.
        keyframes: numbers of the frames that can be decoded without earlier ones, ascending.
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
        """The last keyframe at or before ``frame``; 0 where there is none."""
        count = int(np.searchsorted(self.keyframes, frame, side="right"))
        return self.keyframes[count - 1] if count else 0


def index_video(path: Path) -> VideoIndex:
    """Index a video from its packets; decodes its first and last frame as a check.

    Raises:
        UserError: when the file is no video, is truncated, has rotation metadata, or has a variable frame rate.
    """
    if not path.is_file():
        raise UserError(f"{path}: expected a video, got no such file; copy it again")
    try:
        with av.open(str(path)) as container:
            if not container.streams.video:
                raise UserError(f"{path}: expected a video, got a file without pictures; remove it")
            stream = container.streams.video[0]
            declared = stream.frames
            packets = [(packet.pts, packet.is_keyframe) for packet in container.demux(stream) if packet.pts is not None]
            base = stream.time_base
        if not packets or base is None:
            raise UserError(f"{path}: expected a video's frames, got none; copy it again")
        if len(packets) < declared:
            raise _truncated(path, len(packets), declared)
        missing = missing_bytes(path)
        if missing:
            size = path.stat().st_size
            raise UserError(
                f"{path}: expected {size + missing} bytes, as its header declares, got {size}; copy or record it again"
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
    """Reads frames of a video. Frames in ascending order are decoded once; others from the keyframe before them.

    Not thread-safe. Close it, or use it as a context manager.
    """

    def __init__(self, path: Path, index: VideoIndex) -> None:
        self.path = path
        self.index = index
        self._container: av.container.InputContainer | None = None
        self._frames: Iterator[av.VideoFrame] = iter(())
        self._next = 0
        self._last: tuple[int, NDArray[np.uint8]] | None = None

    def __reduce__(self) -> tuple[type[VideoReader], tuple[Path, VideoIndex]]:
        """Pickled without the open file; another process opens it again."""
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
        """(H, W, 3) uint8 RGB of a frame by number, read-only.

        Raises:
            UserError: when the video is damaged there or ends before.
            ValueError: when the number is out of range.
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
            # Frames earlier than the keyframe may follow it in the file, and some containers seek too far.
            self._seek(0)
            found = self._decode_until(number)
        if found is None:
            raise _truncated(self.path, self._next, self.index.frames)
        return np.asarray(found.to_ndarray(format="rgb24"), np.uint8)

    def _decode_until(self, wanted: int) -> av.VideoFrame | None:
        """Decode up to the frame ``wanted``; None where it is missing."""
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
    """(width, height) of the first frame; raises UserError for rotation metadata."""
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            if frame.rotation % 360:
                raise UserError(
                    f"{path}: expected frames stored upright, got rotation metadata of {frame.rotation % 360} degrees, "
                    "as phones write it; rotate the frames: "
                    f"ffmpeg -i {path.name} -crf 12 upright-{path.name}"
                )
            return frame.width, frame.height
    raise UserError(f"{path}: expected a video's frames, got none that can be decoded; copy it again")


def _constant_rate(path: Path, pts: NDArray[np.int64], base: Fraction) -> Fraction:
    """The constant frame rate in 1/s; rounding of times to the container's ticks is tolerated."""
    if len(pts) == 1:
        return Fraction(1)
    step = Fraction(int(pts[-1] - pts[0]), len(pts) - 1)
    if step <= 0:
        raise UserError(
            f"{path}: expected frames at increasing times, got several at one time; re-encode it with ffmpeg"
        )
    jitter = np.abs(pts - pts[0] - np.arange(len(pts)) * float(step)) / float(step)
    if jitter.max() > MAX_JITTER and jitter.max() * float(step) > 1:
        steps = np.diff(pts) * float(base)
        raise UserError(
            f"{path}: expected a constant frame rate, got intervals of {1e3 * steps.min():.1f} to "
            f"{1e3 * steps.max():.1f} ms (first deviation at frame {int(np.argmax(jitter > MAX_JITTER))}); re-encode "
            f"it: ffmpeg -i {path.name} -fps_mode cfr -crf 12 even-{path.name}"
        )
    return (1 / (step * base)).limit_denominator(1001)


def _truncated(path: Path, got: int, declared: int) -> UserError:
    return UserError(f"{path}: expected {declared} frames, got {got} before its end; copy or record it again")


def _damaged(path: Path, error: Exception) -> UserError:
    reason = getattr(error, "strerror", None) or str(error)
    return UserError(f"{path}: expected a whole video, got '{reason}'; copy it again")
