"""videos.json: a capture's videos, where their frames lie, and by how many frames each runs late."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from fourd.capture.layout import VIDEOS, find_videos
from fourd.capture.video import VideoIndex, index_video
from fourd.errors import UserError
from fourd.files import write_text_atomically

NAME = "videos.json"
KEPT = Path(".fourd") / NAME
"""What was indexed beside it: a source's videos, and those of a capture that came without a list."""
VERSION = 1

Entry = dict[str, Any]


@dataclass(frozen=True)
class Video:
    """A camera's video in a capture.

    Attributes:
        path: of the file.
        index: where its frames lie.
        offset: number in the video of the capture's frame 0, at least 0.
    """

    path: Path
    index: VideoIndex
    offset: int

    @property
    def frames_left(self) -> int:
        """Frames from the offset on; none when it is past the end."""
        return max(0, self.index.frames - self.offset)


def list_videos(capture: Path, names: Iterable[str] | None = None) -> dict[str, Video]:
    """The videos of ``capture``/videos by camera, as videos.json or else .fourd/videos.json has them.

    Those that both lack are indexed now; :func:`fourd.capture.video_index.index_capture` keeps that.

    Args:
        capture: the capture's folder.
        names: cameras to list; None for all.

    Raises:
        UserError: when two videos have one name, videos.json is damaged, or a video cannot be used.
    """
    files = find_videos(capture / VIDEOS)
    listing, kept = capture / NAME, capture / KEPT
    known, spare = read_entries(listing), read_entries(kept)
    wanted = files if names is None else [name for name in names if name in files]
    return {
        name: listed(listing, files[name], known[name]) if name in known else listed(kept, files[name], spare.get(name))
        for name in wanted
    }


def write_video_list(capture: Path, videos: Mapping[str, Video]) -> None:
    """Write videos.json atomically."""
    write_entries(capture / NAME, {name: entry_of(video) for name, video in videos.items()})


def write_entries(listing: Path, entries: Mapping[str, Entry]) -> None:
    """Write a list of videos atomically."""
    write_text_atomically(listing, json.dumps({"version": VERSION, "cameras": entries}, indent=1) + "\n")


def aligned(offsets: Mapping[str, int]) -> dict[str, int]:
    """The same offsets between the cameras with the smallest at 0."""
    least = min(offsets.values(), default=0)
    return {name: offset - least for name, offset in offsets.items()}


def common_frames(videos: Mapping[str, Video]) -> int:
    """Number of frames that all videos have after their offsets."""
    return min((video.frames_left for video in videos.values()), default=0)


def entry_of(video: Video) -> Entry:
    """What a list says of a video."""
    status = video.path.stat()
    index = asdict(video.index) | {"start": str(video.index.start), "fps": str(video.index.fps)}
    return {
        "file": video.path.name,
        "bytes": status.st_size,
        "offset": video.offset,
        "index": index,
    }


def is_of(entry: Entry | None, path: Path) -> bool:
    """Whether an entry is of the file as it is now, by name and size."""
    return entry is not None and (entry.get("file"), entry.get("bytes")) == (path.name, path.stat().st_size)


def listed(listing: Path, path: Path, entry: Entry | None) -> Video:
    """The video by its entry; indexed again where there is none or the file is another one. Raises UserError."""
    if entry is None:
        return Video(path, index_video(path), 0)
    try:
        offset, values = int(entry["offset"]), dict(entry["index"])
        values |= {name: Fraction(values[name]) for name in ("start", "fps")}
        index = VideoIndex(**values | {"keyframes": tuple(int(number) for number in values["keyframes"])})
        if offset < 0 or min(index.frames, index.width, index.height) < 1 or index.fps <= 0:
            raise ValueError
        if not is_of(entry, path):
            index = index_video(path)
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        raise _damaged(listing, f"the index of {path.name}") from error
    return Video(path, index, offset)


def read_entries(path: Path) -> dict[str, Entry]:
    """What a list says of each video; nothing where there is no such file. Raises UserError where it is damaged."""
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
    mend = "delete it" if listing.parent.name == KEPT.parent.name else "import again"
    return UserError(f"{listing}: expected {expected}, got something else; {mend}")
