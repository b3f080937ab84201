"""The index of a video: frame size, frame times, and the places from which decoding can start."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import asdict, dataclass, fields, replace
from fractions import Fraction
from functools import cached_property
from math import floor
from typing import Annotated, Any

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from fourd.base.json_file import decode_json
from fourd.base.limits import printable
from fourd.recording.capture.streams.picture import HLG, PQ, reduced_size

MIN_FPS, MAX_FPS = Fraction(1, 1000), 10_000
"""Minimum and maximum frame rate in 1/s. Scenes have the same limits."""
MAX_LABEL_ERROR = Fraction(1, 4)
"""Maximum difference between the time of a decoded frame and the evenly spaced time of its number, as a fraction of the
interval between frames. With a larger difference, the frame is not the one that the index describes."""
MAX_STREAMS = 1000
MAX_NOTES, MAX_NOTE = 16, 300
MAX_ASPECT = 4
FRACTIONS = ("start", "fps", "tick", "aspect")
"""Fields of an index that are stored in JSON as text, for example "30000/1001"."""
Count = Annotated[int, Meta(ge=1, lt=1 << 62)]
Integers = tuple[Annotated[int, Meta(ge=-(1 << 62), lt=1 << 62)], ...]


@dataclass(frozen=True)
class VideoIndex:
    """Frame size, frame times and keyframes of a video.

    Frames are numbered in the order in which they are shown. A decoded frame is recognised by a label. If
    ``by_packets`` is false, the label is the frame's presentation time in ticks, as the container stores it. If
    ``by_packets`` is true, the container's times do not identify frames, and the label is the position of the frame's
    packet among all packets of the stream, in the order of the file.

    Attributes:
        width: width of the frames in pixels, after they are stretched to square pixels, turned upright and multiplied
            by ``scale``.
        height: height of the frames in pixels.
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
        stored_width: width of the frames in the file in pixels, before all changes.
        stored_height: height of the frames in the file in pixels.
        aspect: width of a stored pixel divided by its height.
        stream: number of the video's stream in the container.
        is_interlaced: whether the frames consist of two fields of different times and are deinterlaced.
        is_strict: whether the decoder can report damaged data, because it finds none at the start of the video.
        by_packets: whether labels are positions of packets instead of times.
        order: with ``by_packets``, the label of each frame minus the frame's number; empty if all are 0.
        positions: with ``by_packets``, the position in bytes of the packet of each keyframe.
        sizes: with ``by_packets``, the size in bytes of the packet of each keyframe.
        decode_times: with ``by_packets``, the decoding time in ticks of each keyframe.
        notes: statements for the user about the choices that were made when the index was created.
    """

    width: Count
    height: Count
    frames: Count
    start: Fraction
    fps: Fraction
    keyframes: Integers
    turn: int = 0
    transfer: str = ""
    scale: float = 1.0
    tick: Fraction = Fraction(1)
    times: Integers = ()
    stored_width: Count = 1
    stored_height: Count = 1
    aspect: Fraction = Fraction(1)
    stream: Annotated[int, Meta(ge=0, lt=MAX_STREAMS)] = 0
    is_interlaced: bool = False
    is_strict: bool = False
    by_packets: bool = False
    order: Integers = ()
    positions: Integers = ()
    sizes: Integers = ()
    decode_times: Integers = ()
    notes: tuple[str, ...] = ()

    @property
    def unturned_size(self) -> tuple[int, int]:
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

    def keyframe_count(self, frame: int) -> int:
        """Return the number of keyframes at or before ``frame``."""
        return bisect_right(self.keyframes, frame)

    def number(self, label: int) -> int | None:
        """Return the number of the frame with a label, or None if the index has no such frame.

        Labels are times in ticks, or positions of packets (see the class).
        """
        if self.by_packets:
            return self._number_of_packet(label) if self.order else _in_range(label, self.frames)
        ticks = label - round(self.start / self.tick)
        if self.times:
            number = bisect_left(self.times, ticks)
            return number if number < self.frames and self.times[number] == ticks else None
        exact = ticks * self.tick * self.fps
        number = round(exact)
        return _in_range(number, self.frames) if abs(exact - number) <= MAX_LABEL_ERROR else None

    def label(self, frame: int) -> int:
        """Return the position of the packet of a frame among all packets; only with ``by_packets``."""
        return frame + (self.order[frame] if self.order else 0)

    def _number_of_packet(self, label: int) -> int | None:
        labels, numbers = self._sorted_labels
        at = int(np.searchsorted(labels, label))
        return int(numbers[at]) if at < len(labels) and labels[at] == label else None

    @cached_property
    def _sorted_labels(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The labels in ascending order, and the numbers of their frames."""
        labels = np.array(self.order, np.int64) + np.arange(self.frames)
        numbers = np.argsort(labels)
        return labels[numbers], numbers


def _in_range(number: int, count: int) -> int | None:
    return number if 0 <= number < count else None


def index_to_json(index: VideoIndex) -> dict[str, Any]:
    """Convert an index to JSON values."""
    return asdict(index) | {name: str(getattr(index, name)) for name in FRACTIONS}


def index_from_json(values: Any) -> VideoIndex:
    """Create an index from its JSON values. Raises ValueError if the values are invalid."""
    # An unknown field may change the meaning of the others, so the index is made again.
    if isinstance(values, dict) and not values.keys() <= {each.name for each in fields(VideoIndex)}:
        raise ValueError("expected the fields of an index")
    index = decode_json(values, VideoIndex)
    index = replace(index, notes=tuple(printable(note)[:MAX_NOTE] for note in index.notes[:MAX_NOTES]))
    is_turned = index.turn in (0, 90, 180, 270) and index.transfer in ("", HLG, PQ) and 0 < index.scale <= 1
    is_rate = MIN_FPS <= index.fps <= MAX_FPS and index.tick > 0 and Fraction(1, MAX_ASPECT) <= index.aspect
    if not is_rate or index.aspect > MAX_ASPECT:
        raise ValueError("expected frame rates and pixels in range")
    if not (is_turned and _is_in_order(index)) or (index.keyframes and index.keyframes[-1] >= index.frames):
        raise ValueError("expected frames in order")
    return index


def _is_in_order(index: VideoIndex) -> bool:
    is_ascending = all(list(each) == sorted(set(each)) and min(each, default=0) >= 0 for each in _ascending(index))
    has_times = not index.times or len(index.times) == index.frames
    has_order = not index.order or len({frame + late for frame, late in enumerate(index.order)}) == index.frames
    places = {len(each) for each in (index.positions, index.sizes, index.decode_times)}
    return is_ascending and has_times and has_order and places == {len(index.keyframes) if index.by_packets else 0}


def _ascending(index: VideoIndex) -> tuple[tuple[int, ...], ...]:
    return index.keyframes, index.times
