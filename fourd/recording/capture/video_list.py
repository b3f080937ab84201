"""Reading and writing of videos.json, which lists a capture's videos. Each entry contains the video's time offset and
its index (frame count, frame times and keyframes).

The frames of a capture are evenly spaced in time on a common clock. Each capture frame uses, from each video, the frame
that is nearest in time.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from math import floor
from pathlib import Path
from typing import Any

from fourd.base.errors import UserError, command_line
from fourd.base.files import write_text_atomically
from fourd.base.limits import read_fraction, read_json
from fourd.base.processes.isolation import ParserProcess
from fourd.recording.capture.frame_rate import format_rate
from fourd.recording.capture.layout import DERIVED, VIDEOS, find_videos
from fourd.recording.capture.video import MAX_FPS, MIN_FPS, VideoIndex, index_from_json, index_to_json, index_video

NAME = "videos.json"
CACHE = DERIVED / NAME
"""Cache file in a capture for indices of videos that videos.json does not list, for example during an import."""
VERSION = 3
INDEX_VERSION = 3
"""Oldest version of the file whose indices are used. Older indices can name other frames, so the videos are indexed
again."""
OUTDATED = "outdated"
"""Key that :func:`read_entries` adds to entries of older versions."""
OFFSET_DECIMALS = 4
MAX_OFFSET = 1e9
MAX_PIXELS = 1 << 28
"""Maximum number of pixels of a frame."""
MAX_DRIFT_FRAMES = 0.5
"""The frame rates of two videos count as equal if the videos drift apart by at most this number of frames."""

Entry = dict[str, Any]


@dataclass(frozen=True)
class Video:
    """A camera's video in a capture.

    Attributes:
        path: the video file.
        index: frame count, times and keyframes of the video.
        offset: time from the video's first frame to frame 0 of the capture, in frames of the capture, at least 0.
        fps: frame rate of the capture in 1/s, or None for the frame rate of the video.
    """

    path: Path
    index: VideoIndex
    offset: float
    fps: Fraction | None = None

    @property
    def rate(self) -> Fraction:
        """Frame rate of the capture in 1/s."""
        return self.fps or self.index.fps

    def seconds(self, frame: int) -> Fraction:
        """Return the time in seconds from the video's first frame to a frame of the capture."""
        return (frame + Fraction(self.offset)) / self.rate

    def number(self, frame: int) -> int:
        """Return the number of the video frame that is nearest in time to the capture's frame ``frame``."""
        return self.index.nearest(self.seconds(frame))

    @property
    def frames_left(self) -> int:
        """Number of frames of the capture from frame 0 to the end of the video, or 0 if the video ends before frame
        0."""
        last = self.index.elapsed(self.index.frames - 1) + 1 / (2 * self.index.fps)
        return max(0, floor(last * self.rate - Fraction(self.offset)) + 1)

    def clock_error(self, frames: int) -> tuple[float, int]:
        """Compare the time of each frame of the capture with the time of the nearest video frame, and find the largest
        difference in seconds.

        Args:
            frames: number of frames of the capture.

        Returns:
            The largest difference and the frame of the capture at which it occurs.
        """
        seconds = ((self.seconds(frame), frame) for frame in range(frames))
        return max((abs(float(self.index.elapsed(self.index.nearest(at)) - at)), frame) for at, frame in seconds)

    def drifts_from(self, fps: Fraction) -> bool:
        """Return whether the video, over its whole length, drifts by more than half a frame from a video with the frame
        rate ``fps``."""
        return abs(float(self.index.fps / fps) - 1) * self.index.frames > MAX_DRIFT_FRAMES


def list_videos(capture: Path, names: Iterable[str] | None = None) -> dict[str, Video]:
    """List the videos in ``capture``/videos, keyed by camera name.

    The index of a video, which contains its frame size, frame times and keyframes, is read from videos.json, or else
    from the cache file .fourd/videos.json. If neither file contains the video, its index is created but not cached.
    :func:`fourd.recording.capture.video_index.index_capture` caches indices.

    Args:
        capture: the capture's folder.
        names: names of the cameras, or None for all cameras.

    Raises:
        UserError: if two videos have the same name, videos.json is damaged, a video cannot be used, or a video that
            videos.json does not list has non-square pixels.
    """
    files = find_videos(capture / VIDEOS)
    path, cache = capture / NAME, capture / CACHE
    fps = read_clock(path)
    listed, cached = read_entries(path), read_entries(cache)
    videos = {}
    with ParserProcess() as parser:
        for name in files if names is None else [name for name in names if name in files]:
            entry = listed.get(name)
            if entry is None:
                videos[name] = load_video(cache, files[name], cached.get(name), parser)
                _require_square(capture, videos[name])
            elif is_outdated(entry):
                current = load_video(cache, files[name], cached.get(name), parser)
                videos[name] = replace(_update(path, entry, current), fps=fps)
            else:
                videos[name] = replace(load_video(path, files[name], entry, parser), fps=fps)
    return videos


def _require_square(capture: Path, video: Video) -> None:
    """Raise UserError if the pixels of a video are not square, because its calibration can belong to the stored frames
    or to the stretched ones. The import decides this."""
    if video.index.aspect != 1:
        raise UserError(
            f"{video.path}: expected square pixels, or a capture that fourd import has written, got pixels of the "
            f"aspect ratio {video.index.aspect.numerator}:{video.index.aspect.denominator}; stretch the frames and the "
            f"calibration with: {command_line('fourd', 'import', capture, 'OUT')}"
        )


def is_outdated(entry: Entry) -> bool:
    """Return whether an older version of fourd has written the index in an entry of videos.json."""
    return bool(entry.get(OUTDATED))


def _update(listing: Path, entry: Entry, video: Video) -> Video:
    """Return a video with a new index and the offset and scale of its outdated ``entry``.

    Raises:
        UserError: if the frames now have another size, for example because their pixels are not square.
    """
    try:
        old, offset = entry["index"], entry["offset"]
        index = video.index.reduce(float(old.get("scale", 1.0)))
        size = (old["width"], old["height"])
        if not (isinstance(offset, int | float) and 0 <= offset < MAX_OFFSET and 0 < index.scale <= 1):
            raise ValueError
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _damaged(listing, f"the index of {video.path.name}") from error
    if size != (index.width, index.height):
        raise UserError(
            f"{listing}: expected frames of {size[0]} x {size[1]} pixels in {video.path.name}, got {index.width} x "
            f"{index.height}, because this version stretches non-square pixels; import again"
        )
    return replace(video, index=index, offset=offset)


def write_video_list(capture: Path, videos: Mapping[str, Video]) -> None:
    """Atomically write the videos.json of a capture."""
    write_entries(capture / NAME, {name: make_entry(video) for name, video in videos.items()}, common_rate(videos))


def write_entries(path: Path, entries: Mapping[str, Entry], fps: Fraction | None = None) -> None:
    """Atomically write the video entries ``entries``, keyed by camera name, to a file in the format of videos.json.

    ``fps`` is the frame rate of the capture in 1/s. If ``fps`` is None, as for the cache file in ``.fourd/``, no frame
    rate is written.
    """
    content = {"version": VERSION, **({} if fps is None else {"fps": str(fps)}), "cameras": entries}
    # Lists with a number for each frame of a long video would be several times larger with line breaks.
    write_text_atomically(path, json.dumps(content, separators=(",", ":")) + "\n")


def align_offsets(offsets: Mapping[str, float]) -> dict[str, float]:
    """Shift the time offsets of videos, in frames, by the same number, so that the smallest is 0. Round them to 4
    decimals."""
    least = min(offsets.values(), default=0)
    return {name: round(offset - least, OFFSET_DECIMALS) for name, offset in offsets.items()}


def align_videos(
    files: Mapping[str, Path], indices: Mapping[str, VideoIndex], offsets: Mapping[str, float]
) -> dict[str, Video]:
    """Put videos on a common clock: each frame number of the capture denotes the same time in all videos, and the frame
    rate is the lowest of all videos.

    Args:
        files: path of each video by camera name.
        indices: index of each video.
        offsets: offset of each video in frames of the common clock, keyed by camera name. In a video with the offset 7,
            each event appears 7 frames later, counted from the start of the video, than in a video with the offset 0.
            Missing offsets are 0.

    Raises:
        UserError: if a video ends before another video starts.
    """
    starts = align_offsets({name: offsets.get(name, 0) for name in files})
    fps = min((indices[name].fps for name in files), default=None)
    videos = {name: Video(path, indices[name], starts[name], fps) for name, path in files.items()}
    for name, video in videos.items():
        if not video.frames_left:
            duration = video.index.frames / video.index.fps
            raise UserError(
                f"{video.path}: expected a video that overlaps in time with the other videos, got "
                f"{float(duration):.3g} s that end before another video starts; change the --offset of '{name}', or "
                "leave the video out"
            )
    return videos


def common_frames(videos: Mapping[str, Video]) -> int:
    """Return the number of frames of the capture: the minimum of :attr:`Video.frames_left` over all videos."""
    return min((video.frames_left for video in videos.values()), default=0)


def common_rate(videos: Mapping[str, Video]) -> Fraction | None:
    """Return the frame rate of the capture in 1/s, or None if there is no video.

    Raises:
        UserError: if a video is not on a common clock (:attr:`Video.fps` is None), and its own frame rate differs from
            the lowest frame rate of all videos.
    """
    fps = min((video.rate for video in videos.values()), default=None)
    for video in videos.values():
        if fps is not None and video.fps is None and video.drifts_from(fps):
            raise UserError(
                f"{video.path}: expected {format_rate(fps)} frames per second, like another video, got "
                f"{format_rate(video.index.fps)}; put the videos on a common clock with: fourd import"
            )
    return fps


def make_entry(video: Video) -> Entry:
    """Create the entry of a video in videos.json."""
    status = video.path.stat()
    return {
        "file": video.path.name,
        "bytes": status.st_size,
        "offset": video.offset,
        "index": index_to_json(video.index),
    }


def is_entry_current(entry: Entry | None, path: Path) -> bool:
    """Return whether a video's ``entry`` is of this version, and its name and size match the file at ``path``."""
    if entry is None or is_outdated(entry):
        return False
    return (entry.get("file"), entry.get("bytes")) == (path.name, path.stat().st_size)


def load_video(listing: Path, path: Path, entry: Entry | None, parser: ParserProcess | None = None) -> Video:
    """Create a video from its ``entry`` in the file ``listing``.

    A new index is created if there is no entry, or if the file at ``path`` has changed since the entry was written.
    ``parser`` is the child process that creates the index, see :func:`fourd.recording.capture.video.index_video`.

    Raises:
        UserError: if the entry is damaged or the video cannot be used.
    """
    if entry is None or is_outdated(entry):
        return Video(path, index_video(path, parser), 0)
    try:
        offset = entry["offset"]
        index = index_from_json(entry["index"])
        if not (isinstance(offset, int | float) and 0 <= offset < MAX_OFFSET):
            raise ValueError
        if not is_entry_current(entry, path):
            index = index_video(path, parser).reduce(index.scale)
        if index.frames > path.stat().st_size or index.width * index.height > MAX_PIXELS:
            raise ValueError
    except (KeyError, TypeError, ValueError) as error:
        raise _damaged(listing, f"the index of {path.name}") from error
    return Video(path, index, offset)


def read_entries(path: Path) -> dict[str, Entry]:
    """Read the entries, keyed by camera name, of a file in the format of videos.json. The result is empty if there is
    no file.

    Raises:
        UserError: if the file is damaged.
    """
    try:
        content = read_json(path)
        if content["version"] not in range(1, VERSION + 1):
            raise UserError(f"{path}: expected version {VERSION} or older, got {content['version']}; import again")
        is_old = {OUTDATED: True} if content["version"] < INDEX_VERSION else {}
        return {name: dict(entry) | is_old for name, entry in dict(content["cameras"]).items()}
    except FileNotFoundError:
        return {}
    except (ValueError, KeyError, TypeError) as error:
        raise _damaged(path, "the list of this capture's videos") from error


def read_clock(path: Path) -> Fraction | None:
    """Read the capture's frame rate in 1/s from videos.json, or None if the file does not exist or has no rate.

    Raises:
        UserError: if the file is damaged.
    """
    try:
        fps = read_json(path).get("fps") if path.exists() else None
        rate = None if fps is None else read_fraction(fps)
        if rate is not None and not MIN_FPS <= rate <= MAX_FPS:
            raise ValueError
    except (ValueError, TypeError, AttributeError) as error:
        raise _damaged(path, "the list of this capture's videos") from error
    return rate


def _damaged(listing: Path, expected: str) -> UserError:
    fix = "delete the file" if listing.parent.name == CACHE.parent.name else "import again"
    return UserError(f"{listing}: expected {expected}, got invalid content; {fix}")
