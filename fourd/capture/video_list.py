"""Reading and writing of videos.json, which lists the videos of a capture with their indices and offsets in frames."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from fourd.capture.layout import DERIVED, VIDEOS, find_videos
from fourd.capture.video import VideoIndex, index_video
from fourd.errors import UserError
from fourd.files import write_text_atomically

NAME = "videos.json"
CACHE = DERIVED / NAME
"""Cache file in a capture for indices of videos that videos.json does not list, for example during an import."""
VERSION = 1

Entry = dict[str, Any]


@dataclass(frozen=True)
class Video:
    """A camera's video in a capture.

    Attributes:
        path: the video file.
        index: frame count, times and keyframes of the video.
        offset: frame number in the video that corresponds to frame 0 of the capture; at least 0.
    """

    path: Path
    index: VideoIndex
    offset: int

    @property
    def frames_left(self) -> int:
        """Number of frames of the video from frame ``offset`` to the end, at least 0."""
        return max(0, self.index.frames - self.offset)


def list_videos(capture: Path, names: Iterable[str] | None = None) -> dict[str, Video]:
    """List the videos in ``capture``/videos by camera name.

    A video's index is read from videos.json, or else from the cache file .fourd/videos.json. If neither file contains
    the video, its index is created but not cached. :func:`fourd.capture.video_index.index_capture` caches indices.

    Args:
        capture: the capture's folder.
        names: names of the cameras, or None for all cameras.

    Raises:
        UserError: if two videos have the same name, videos.json is damaged, or a video cannot be used.
    """
    files = find_videos(capture / VIDEOS)
    path, cache = capture / NAME, capture / CACHE
    listed, cached = read_entries(path), read_entries(cache)
    videos = {}
    for name in files if names is None else [name for name in names if name in files]:
        if name in listed:
            videos[name] = load_video(path, files[name], listed[name])
        else:
            videos[name] = load_video(cache, files[name], cached.get(name))
    return videos


def write_video_list(capture: Path, videos: Mapping[str, Video]) -> None:
    """Atomically write the videos.json of a capture."""
    write_entries(capture / NAME, {name: make_entry(video) for name, video in videos.items()})


def write_entries(path: Path, entries: Mapping[str, Entry]) -> None:
    """Atomically write the entries of videos by camera name to a file in the format of videos.json."""
    write_text_atomically(path, json.dumps({"version": VERSION, "cameras": entries}, indent=1) + "\n")


def align_offsets(offsets: Mapping[str, int]) -> dict[str, int]:
    """Shift all offsets by the same number so that the smallest is 0."""
    least = min(offsets.values(), default=0)
    return {name: offset - least for name, offset in offsets.items()}


def common_frames(videos: Mapping[str, Video]) -> int:
    """Number of frames of the capture: the minimum of :attr:`Video.frames_left` over all videos."""
    return min((video.frames_left for video in videos.values()), default=0)


def common_rate(videos: Mapping[str, Video]) -> Fraction | None:
    """Frame rate of the capture in 1/s: the lowest rate of the videos, or None if there is no video."""
    return min((video.index.fps for video in videos.values()), default=None)


def make_entry(video: Video) -> Entry:
    """Create a video's entry for videos.json."""
    status = video.path.stat()
    index = asdict(video.index) | {"start": str(video.index.start), "fps": str(video.index.fps)}
    return {
        "file": video.path.name,
        "bytes": status.st_size,
        "offset": video.offset,
        "index": index,
    }


def is_entry_current(entry: Entry | None, path: Path) -> bool:
    """Whether the name and size in a video's ``entry`` match the file at ``path``."""
    return entry is not None and (entry.get("file"), entry.get("bytes")) == (path.name, path.stat().st_size)


def load_video(listing: Path, path: Path, entry: Entry | None) -> Video:
    """Create a video from its ``entry`` in the file ``listing``.

    A new index is created if there is no entry, or if the file at ``path`` has changed since the entry was written.

    Raises:
        UserError: if the entry is damaged or the video cannot be used.
    """
    if entry is None:
        return Video(path, index_video(path), 0)
    try:
        offset, values = int(entry["offset"]), dict(entry["index"])
        values |= {name: Fraction(values[name]) for name in ("start", "fps")}
        index = VideoIndex(**values | {"keyframes": tuple(int(number) for number in values["keyframes"])})
        if offset < 0 or min(index.frames, index.width, index.height) < 1 or index.fps <= 0:
            raise ValueError
        if not is_entry_current(entry, path):
            index = index_video(path)
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        raise _damaged(listing, f"the index of {path.name}") from error
    return Video(path, index, offset)


def read_entries(path: Path) -> dict[str, Entry]:
    """Read a file in the format of videos.json: the entries by camera name, or no entries if the file does not exist.

    Raises:
        UserError: if the file is damaged.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["version"] != VERSION:
            raise UserError(f"{path}: expected version {VERSION}, got {content['version']}; import again")
        return dict(content["cameras"])
    except FileNotFoundError:
        return {}
    except (ValueError, KeyError, TypeError) as error:
        raise _damaged(path, "the list of this capture's videos") from error


def _damaged(listing: Path, expected: str) -> UserError:
    fix = "delete the file" if listing.parent.name == CACHE.parent.name else "import again"
    return UserError(f"{listing}: expected {expected}, got invalid content; {fix}")
