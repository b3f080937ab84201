"""Random access to the frames of a video by frame number. Frames are not extracted to disk."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from fractions import Fraction
from math import floor
from pathlib import Path
from typing import Any

import av
import numpy as np
from av.container import InputContainer
from numpy.typing import NDArray

from fourd.capture.frame_rate import STANDARD_TOLERANCE, standard_rate
from fourd.capture.matroska import missing_bytes
from fourd.capture.video_picture import HLG, PQ, reduced_size, to_rgb, transfer_of, turn_of
from fourd.errors import UserError
from fourd.limits import read_fraction, require_regular
from fourd.processes.isolation import ParserProcess

CONTAINERS = "mov,mp4,matroska,webm,avi,mpegts,h264,hevc"
"""Names of the FFmpeg demuxers for the formats of :data:`fourd.capture.layout.VIDEO_SUFFIXES`, and for raw streams. Raw
streams are included so that a later check can reject them with an error message that explains the fix."""
MAX_JITTER = 0.05
"""Maximum deviation of a frame's time from a constant frame rate, as a fraction of the interval between frames. If any
frame deviates more, the index stores the time of every frame."""
MAX_RATE_ERROR = 5e-3
"""Maximum relative difference at which the mean rate of unevenly spaced frames is replaced by the nearest standard
rate. For videos whose frame times have little jitter, the limit is lower."""
MIN_FPS, MAX_FPS = Fraction(1, 1000), 10_000
"""Minimum and maximum frame rate in 1/s. Scenes have the same limits."""
PROBE_THREADS = 2
"""Number of threads that decode the first and the last frame of a video. It is small, because each thread keeps several
frames in memory."""
FRACTIONS = ("start", "fps", "tick")
"""Fields of an index that are stored in JSON as text, for example "30000/1001"."""


@dataclass(frozen=True)
class VideoIndex:
    """Frame size, frame times and keyframes of a video.

    Attributes:
        width: width of the decoded frames in pixels, after they are turned upright and multiplied by ``scale``.
        height: height of the decoded frames in pixels.
        frames: number of frames.
        start: presentation time of frame 0 in seconds.
        fps: frame rate in 1/s. Dropped frames do not lower it.
        keyframes: ascending numbers of the frames that can be decoded without earlier frames.
        turn: angle in degrees, a multiple of 90, by which the video's metadata turns the stored frames
            counter-clockwise.
        transfer: "HLG" or "PQ" for HDR video, which is converted to sRGB, otherwise "".
        scale: factor in (0, 1] that multiplies width and height of the frames when they are decoded.
        tick: unit of ``times``, in seconds.
        times: if the frame times are uneven, the time from frame 0 to each frame, in ticks; otherwise empty.
    """

    width: int
    height: int
    frames: int
    start: Fraction
    fps: Fraction
    keyframes: tuple[int, ...]
    turn: int = 0
    transfer: str = ""
    scale: float = 1.0
    tick: Fraction = Fraction(1)
    times: tuple[int, ...] = ()

    @property
    def stored_size(self) -> tuple[int, int]:
        """Width and height in pixels of the frames before they are turned upright."""
        return (self.height, self.width) if self.turn % 180 else (self.width, self.height)

    def reduce(self, scale: float) -> VideoIndex:
        """Return a copy of the index that makes the reader scale decoded frames by ``scale``, a factor in (0, 1]."""
        width, height = reduced_size(self.width, self.height, scale)
        return replace(self, width=width, height=height, scale=scale)

    def time(self, frame: int) -> Fraction:
        """Return the presentation time of a frame in seconds."""
        return self.start + self.elapsed(frame)

    def elapsed(self, frame: int) -> Fraction:
        """Return the time in seconds from frame 0 to a frame."""
        return self.times[frame] * self.tick if self.times else frame / self.fps

    def nearest(self, seconds: Fraction) -> int:
        """Return the number of the frame that is nearest to the time ``seconds`` after frame 0.

        If two frames are equally near, the number of the later frame is returned.
        """
        if not self.times:
            return min(max(floor(seconds * self.fps + Fraction(1, 2)), 0), self.frames - 1)
        ticks = seconds / self.tick
        after = min(bisect_right(self.times, ticks), self.frames - 1)
        before = max(after - 1, 0)
        return after if self.times[after] - ticks <= ticks - self.times[before] else before

    def keyframe_before(self, frame: int) -> int:
        """Return the number of the last keyframe at or before ``frame``; 0 if there is no such keyframe."""
        count = int(np.searchsorted(self.keyframes, frame, side="right"))
        return self.keyframes[count - 1] if count else 0


def open_container(path: Path) -> InputContainer:
    """Open a video file. Raises av.FFmpegError or OSError if the file is not a video.

    Only the container formats of :data:`CONTAINERS` are read, and only from the file itself, because other formats,
    such as playlists, could make FFmpeg open more files or network addresses.

    Raises:
        UserError: if the file is a named pipe, a socket or a device.
    """
    require_regular(path)
    limits = {"protocol_whitelist": "file", "format_whitelist": CONTAINERS}
    return av.open(str(path), options=limits, metadata_errors="replace")


def index_video(path: Path, parser: ParserProcess | None = None) -> VideoIndex:
    """Create a video's index from its packets, and decode the first and the last frame as a check.

    The video is read in a child process, because a damaged video can crash FFmpeg.

    Args:
        path: the video.
        parser: the child process to use, or None to start one.

    Raises:
        UserError: if the file is not a video, is truncated, or has fewer than 2 frames with presentation times.
            UserError is also raised if several frames have the same time, or if the metadata mirrors the frames or
            turns them by an angle that is not a multiple of 90 degrees.
    """
    if not path.is_file():
        raise UserError(f"{path}: expected a video, got no such file; copy the video again")
    require_regular(path)
    with ParserProcess() if parser is None else nullcontext(parser) as process:
        values = process.call("fourd.capture.video:probe_in_child", path).value
    try:
        return index_from_json(values)
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        raise _damaged(path, error) from error


def probe_in_child(name: str) -> dict[str, Any]:
    """Create a video's index. :func:`index_video` calls this in its child process. Returns the index as JSON values."""
    return index_to_json(_probe(Path(name)))


def index_to_json(index: VideoIndex) -> dict[str, Any]:
    """Convert an index to JSON values."""
    return asdict(index) | {name: str(getattr(index, name)) for name in FRACTIONS}


def index_from_json(values: Any) -> VideoIndex:
    """Create an index from its JSON values. Raises TypeError, KeyError, ValueError or ZeroDivisionError if the values
    are invalid."""
    values = dict(values) | {name: read_fraction(values[name]) for name in FRACTIONS if name in values}
    values |= {name: _whole_numbers(values.get(name, ())) for name in ("keyframes", "times")}
    index = VideoIndex(**values)
    _whole_numbers((index.frames, index.width, index.height))
    is_turned = index.turn in (0, 90, 180, 270) and index.transfer in ("", HLG, PQ) and 0 < index.scale <= 1
    has_times = not index.times or len(index.times) == index.frames
    is_ordered = all(list(each) == sorted(set(each)) for each in (index.keyframes, index.times))
    is_rate = MIN_FPS <= index.fps <= MAX_FPS and index.tick > 0
    if min(index.frames, index.width, index.height) < 1 or not is_rate:
        raise ValueError("expected an index with frames")
    if not (is_turned and has_times and is_ordered) or (index.keyframes and index.keyframes[-1] >= index.frames):
        raise ValueError("expected frames in order")
    return index


def _whole_numbers(values: Any) -> tuple[int, ...]:
    for value in values:
        if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value < 1 << 62:
            raise ValueError("expected whole numbers")
    return tuple(values)


def _probe(path: Path) -> VideoIndex:
    try:
        with open_container(path) as container:
            if not container.streams.video:
                raise UserError(f"{path}: expected a video, got a file without a video stream; remove the file")
            stream = container.streams.video[0]
            declared = stream.frames
            # ``is_discard`` marks frames that the edit list of an MP4 file excludes and the decoder discards.
            found = [
                (packet.pts, packet.is_keyframe, packet.is_discard) for packet in container.demux(stream) if packet.size
            ]
            base = stream.time_base
        if not found:
            raise UserError(f"{path}: expected a video with frames, got no frames; copy the file again")
        if len(found) < declared:
            raise _truncated(path, len(found), declared)
        packets = [(pts, is_key) for pts, is_key, is_discarded in found if pts is not None and not is_discarded]
        if not packets or base is None:
            raise _no_times(path, f"{len(found)} frames without times")
        if len(packets) == 1:
            raise UserError(
                f"{path}: expected a video of at least 2 frames, got 1; record the video again, or put this frame as "
                f"an image into the folder {path.stem}/"
            )
        missing = missing_bytes(path)
        if missing:
            size = path.stat().st_size
            raise UserError(
                f"{path}: expected {size + missing} bytes according to the file's header, got {size}; copy or record "
                "the video again"
            )
        packets.sort()
        times = np.array([pts for pts, _ in packets], np.int64)
        fps, is_even = _frame_rate(path, times, base)
        ticks = () if is_even else tuple((times - times[0]).tolist())
        width, height, turn, transfer = first_frame(path)
        keyframes = tuple(number for number, (_, is_key) in enumerate(packets) if is_key)
        start = packets[0][0] * base
        index = VideoIndex(width, height, len(packets), start, fps, keyframes, turn, transfer, 1.0, base, ticks)
        with VideoReader(path, index, PROBE_THREADS) as reader:
            reader.read(len(packets) - 1)
    except (av.FFmpegError, OSError, ValueError, OverflowError) as error:
        raise _damaged(path, error) from error
    return index


class VideoReader:
    """Reads frames of a video by number.

    Reading frames in ascending order decodes each frame once. In other orders, the reader seeks to the last keyframe at
    or before the requested frame, and decodes all frames from this keyframe to the requested frame. Close the reader
    after use, or use it as a context manager. The reader is not thread-safe.
    """

    def __init__(self, path: Path, index: VideoIndex, threads: int = 0) -> None:
        """Create a reader that decodes with ``threads`` threads. If ``threads`` is 0, FFmpeg chooses the number."""
        self.path = path
        self.index = index
        self._threads = threads
        self._container: av.container.InputContainer | None = None
        self._frames: Iterator[av.VideoFrame] = iter(())
        self._next = 0
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
            # The seek missed the requested frame: it went too far, or the frame is a leading frame, which is stored
            # after a keyframe but displayed before it. In both cases, decode from the start of the video.
            self._seek(0)
            found = self._decode_until(number)
        if found is None:
            raise _truncated(self.path, self._next, self.index.frames)
        return to_rgb(found, self.index.turn, self.index.transfer, self.index.scale)

    def _decode_until(self, wanted: int) -> av.VideoFrame | None:
        """Decode frames up to the frame with the index ``wanted``, and return this frame, or None if it is missing."""
        for frame in self._frames:
            if frame.pts is None or frame.time_base is None:
                continue
            number = self._number(frame.pts * frame.time_base - self.index.start)
            self._next = number + 1
            if number >= wanted:
                return frame if number == wanted else None
        return None

    def _number(self, elapsed: Fraction) -> int:
        """Return the number of the frame that is shown ``elapsed`` seconds after frame 0.

        Unlike the result of ``nearest``, the returned number can be outside the video.
        """
        if not self.index.times:
            return round(elapsed * self.index.fps)
        return bisect_left(self.index.times, round(elapsed / self.index.tick))

    def _seek(self, frame: int) -> None:
        if self._container is None:
            self._container = open_container(self.path)
            self._container.streams.video[0].thread_type = "AUTO"
            self._container.streams.video[0].codec_context.thread_count = self._threads
        stream = self._container.streams.video[0]
        assert stream.time_base is not None
        self._container.seek(round(self.index.time(frame) / stream.time_base), stream=stream)
        self._frames = self._container.decode(stream)
        self._next = frame


def first_frame(path: Path) -> tuple[int, int, int, str]:
    """Return the width and height in pixels of the upright first frame, the angle in degrees that turns it upright, and
    its HDR transfer function.

    Raises:
        UserError: if no frame can be decoded, or the metadata mirrors the frames or turns them by an angle that is not
            a multiple of 90 degrees.
    """
    with open_container(path) as container:
        for frame in container.decode(video=0):
            turn = turn_of(frame)
            if turn is None:
                raise UserError(
                    f"{path}: expected frames turned by a multiple of 90 degrees and not mirrored, got another display "
                    f"matrix; rotate the frames with: ffmpeg -i {path.name} -crf 12 upright-{path.name}"
                )
            width, height = (frame.height, frame.width) if turn % 180 else (frame.width, frame.height)
            return width, height, turn, transfer_of(frame)
    raise UserError(f"{path}: expected a video with frames, got no frame that can be decoded; copy the file again")


def _frame_rate(path: Path, pts: NDArray[np.int64], base: Fraction) -> tuple[Fraction, bool]:
    """Compute the frame rate in 1/s from the ascending times of at least 2 frames. Also return whether the times are
    evenly spaced.

    The times ``pts`` are integers in units of ``base`` seconds, the container's time base, so they may be rounded. If
    the times are uneven, as in phone videos, an interval with dropped frames counts as several intervals.

    Raises:
        UserError: if several frames have the same time.
    """
    steps = np.diff(pts)
    if steps.min() <= 0:
        number = int(np.argmax(steps <= 0))
        raise _no_times(path, f"frames {number} and {number + 1} at the same time")
    step = Fraction(int(pts[-1] - pts[0]), len(pts) - 1)
    jitter = np.abs(pts - pts[0] - np.arange(len(pts)) * float(step))
    if jitter.max() <= MAX_JITTER * float(step) or jitter.max() <= 1:
        return _rounded_rate(path, 1 / (step * base)), True
    # Fit a line to the times as a function of the frame numbers (least squares). Dropped frames are numbered, too.
    numbers = np.cumsum([0, *np.maximum(np.rint(steps / np.median(steps)), 1)])
    (interval, _), covariance = np.polyfit(numbers, pts - pts[0], 1, cov=True)
    # The tolerance for standard rates is 3 times the standard error of the interval, which grows with the jitter.
    error = float(np.sqrt(covariance[0, 0])) / float(interval)
    tolerance = min(max(3 * error, STANDARD_TOLERANCE), MAX_RATE_ERROR)
    rate = 1 / (Fraction(float(interval)) * base)
    return standard_rate(rate, tolerance) if rate >= 1 else _rounded_rate(path, rate), False


def _rounded_rate(path: Path, rate: Fraction) -> Fraction:
    """Round a frame rate in 1/s to a fraction. Its denominator is at most 1001 for rates of at least 1/s; its numerator
    is at most 1001 for rates below 1/s."""
    if not MIN_FPS <= rate <= MAX_FPS:
        raise _no_times(path, f"one frame each {float(1 / rate):.3g} s")
    return rate.limit_denominator(1001) if rate >= 1 else 1 / (1 / rate).limit_denominator(1001)


def _no_times(path: Path, got: str) -> UserError:
    return UserError(
        f"{path}: expected frames at increasing times, 0.1 ms to 1000 s apart, got {got}; write times of, for example, "
        f"30 frames per second with: ffmpeg -r 30 -i {path.name} -crf 12 timed-{path.name}"
    )


def _truncated(path: Path, got: int, declared: int) -> UserError:
    return UserError(f"{path}: expected {declared} frames, got {got}; copy or record the video again")


def _damaged(path: Path, error: Exception) -> UserError:
    reason = getattr(error, "strerror", None) or str(error)
    return UserError(f"{path}: expected a complete video, got '{reason}'; copy the file again")
