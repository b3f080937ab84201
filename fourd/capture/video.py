"""One video's frames by number: found by seeking, decoded when asked for, never unpacked to disk."""

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

MOST_UNEVEN = 0.25
"""Of a frame's time: how far a frame may lie from an even rhythm. A dropped frame moves others by a half at least."""


@dataclass(frozen=True)
class VideoIndex:
    """Where a video's frames lie in it.

    Attributes:
        width, height: of the decoded frames, in pixels.
        frames: number of frames.
        start: presentation time of frame 0, seconds.
        fps: frames per second.
        keyframes: numbers of the frames that can be decoded without those before, ascending.
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
        """The last keyframe that is not after ``frame``; frame 0 where the first is no keyframe."""
        place = int(np.searchsorted(self.keyframes, frame, side="right"))
        return self.keyframes[place - 1] if place else 0


def index_video(path: Path) -> VideoIndex:
    """Read a video's packets, and decode its first and last frame.

    Raises:
        UserError: one line with the mend, when it is no video, ends early, is to be shown rotated, or its frames
            are not evenly spaced in time.
    """
    if not path.is_file():
        raise UserError(f"{path}: expected a video, got no such file; copy it again")
    try:
        with av.open(str(path)) as container:
            if not container.streams.video:
                raise UserError(f"{path}: expected a video, got a file without pictures; remove it")
            stream = container.streams.video[0]
            promised = stream.frames
            packets = [(packet.pts, packet.is_keyframe) for packet in container.demux(stream) if packet.pts is not None]
            base = stream.time_base
        if not packets or base is None:
            raise UserError(f"{path}: expected a video's frames, got none; copy it again")
        if len(packets) < promised:
            raise _ends_early(path, len(packets), promised)
        lacking = missing_bytes(path)
        if lacking:
            whole = path.stat().st_size + lacking
            raise UserError(
                f"{path}: expected {whole} bytes, as it says, got {whole - lacking}; copy or record it again"
            )
        packets.sort()
        fps = _even_rate(path, np.array([pts for pts, _ in packets], np.int64), base)
        width, height = _first_size(path)
        keyframes = tuple(number for number, (_, is_key) in enumerate(packets) if is_key)
        index = VideoIndex(width, height, len(packets), packets[0][0] * base, fps, keyframes)
        with VideoReader(path, index) as reader:
            reader.read(len(packets) - 1)
    except (av.FFmpegError, OSError, ValueError) as error:
        raise _damaged(path, error) from error
    return index


class VideoReader:
    """An open video. Frames in rising order cost one decoding each; others a search from the keyframe before.

    Not for several threads at once. Close it, or use it as a context.
    """

    def __init__(self, path: Path, index: VideoIndex) -> None:
        self.path = path
        self.index = index
        self._container: av.container.InputContainer | None = None
        self._frames: Iterator[av.VideoFrame] = iter(())
        self._next = 0
        self._last: tuple[int, NDArray[np.uint8]] | None = None

    def __reduce__(self) -> tuple[type[VideoReader], tuple[Path, VideoIndex]]:
        """Another process opens the file itself."""
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
            ValueError: when it has no frame of that number.
        """
        if not 0 <= frame < self.index.frames:
            raise ValueError(f"frame: expected 0 to {self.index.frames - 1}, got {frame}")
        if self._last is None or self._last[0] != frame:
            try:
                picture = self._decoded(frame)
            except (av.FFmpegError, OSError) as error:
                raise _damaged(self.path, error) from error
            picture.flags.writeable = False
            self._last = (frame, picture)
        return self._last[1]

    def _decoded(self, wanted: int) -> NDArray[np.uint8]:
        keyframe = self.index.keyframe_before(wanted)
        if self._container is None or not keyframe <= self._next <= wanted:
            self._seek(keyframe)
        found = self._forward(wanted)
        if found is None:
            # Frames before the keyframe in time may follow it in the file; some containers seek too far.
            self._seek(0)
            found = self._forward(wanted)
        if found is None:
            raise _ends_early(self.path, self._next, self.index.frames)
        return np.asarray(found.to_ndarray(format="rgb24"), np.uint8)

    def _forward(self, wanted: int) -> av.VideoFrame | None:
        """The frame ``wanted`` among those to come; None when a later one comes, or none."""
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
    """(width, height) of the first frame, which must be stored as it is to be shown."""
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            if frame.rotation % 360:
                raise UserError(
                    f"{path}: expected pictures stored upright, got a video to be shown turned by "
                    f"{frame.rotation % 360} degrees, as phones write them; write it upright: "
                    f"ffmpeg -i {path.name} -crf 12 upright-{path.name}"
                )
            return frame.width, frame.height
    raise UserError(f"{path}: expected a video's frames, got none that can be decoded; copy it again")


def _even_rate(path: Path, pts: NDArray[np.int64], base: Fraction) -> Fraction:
    """Frames per second of frames that come evenly; container ticks may round their times."""
    if len(pts) == 1:
        return Fraction(1)
    step = Fraction(int(pts[-1] - pts[0]), len(pts) - 1)
    if step <= 0:
        raise UserError(f"{path}: expected frames at rising times, got several at one time; write it again with ffmpeg")
    aside = np.abs(pts - pts[0] - np.arange(len(pts)) * float(step)) / float(step)
    if aside.max() > MOST_UNEVEN and aside.max() * float(step) > 1:
        steps = np.diff(pts) * float(base)
        raise UserError(
            f"{path}: expected frames at an even rate, got steps of {1e3 * steps.min():.1f} to "
            f"{1e3 * steps.max():.1f} ms (first uneven at frame {int(np.argmax(aside > MOST_UNEVEN))}); write it "
            f"with a constant rate: ffmpeg -i {path.name} -fps_mode cfr -crf 12 even-{path.name}"
        )
    return (1 / (step * base)).limit_denominator(1001)


def _ends_early(path: Path, got: int, promised: int) -> UserError:
    return UserError(f"{path}: expected {promised} frames, got {got} before its end; copy or record it again")


def _damaged(path: Path, error: Exception) -> UserError:
    reason = getattr(error, "strerror", None) or str(error)
    return UserError(f"{path}: expected a whole video, got '{reason}'; copy it again")
