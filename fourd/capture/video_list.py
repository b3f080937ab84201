"""videos.json: a capture's videos, where their frames lie, and by how many frames each runs late."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from fourd.capture.layout import VIDEOS, videos_in
from fourd.capture.video import VideoIndex, index_video
from fourd.errors import UserError
from fourd.files import write_text_atomically

NAME = "videos.json"
VERSION = 1


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
    """The videos of ``capture``/videos by camera, as videos.json has them; those it lacks are indexed now.

    Args:
        capture: the capture's folder.
        names: cameras to list; None for all.

    Raises:
        UserError: when two videos have one name, videos.json is damaged, or a video cannot be used.
    """
    files = videos_in(capture / VIDEOS)
    known = _read(capture / NAME)
    wanted = files if names is None else [name for name in names if name in files]
    return {name: _listed(capture / NAME, files[name], known.get(name)) for name in wanted}


def write_video_list(capture: Path, videos: Mapping[str, Video]) -> None:
    """Write videos.json atomically."""
    content = {"version": VERSION, "cameras": {name: _entry(video) for name, video in videos.items()}}
    write_text_atomically(capture / NAME, json.dumps(content, indent=1) + "\n")


def aligned(offsets: Mapping[str, int]) -> dict[str, int]:
    """The same offsets between the cameras with the smallest at 0."""
    least = min(offsets.values(), default=0)
    return {name: offset - least for name, offset in offsets.items()}


def common_frames(videos: Mapping[str, Video]) -> int:
    """Number of frames that all videos have after their offsets."""
    return min((video.frames_left for video in videos.values()), default=0)


def _entry(video: Video) -> dict[str, Any]:
    status = video.path.stat()
    index = asdict(video.index) | {"start": str(video.index.start), "fps": str(video.index.fps)}
    return {
        "file": video.path.name,
        "bytes": status.st_size,
        "offset": video.offset,
        "index": index,
    }


def _listed(listing: Path, path: Path, entry: dict[str, Any] | None) -> Video:
    """The video by its entry; indexed again where there is none or the file is another one."""
    if entry is None:
        return Video(path, index_video(path), 0)
    try:
        offset, values = int(entry["offset"]), dict(entry["index"])
        values |= {name: Fraction(values[name]) for name in ("start", "fps")}
        index = VideoIndex(**values | {"keyframes": tuple(int(number) for number in values["keyframes"])})
        if offset < 0 or min(index.frames, index.width, index.height) < 1 or index.fps <= 0:
            raise ValueError
        if (entry["file"], entry["bytes"]) != (path.name, path.stat().st_size):
            index = index_video(path)
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        raise UserError(f"{listing}: expected the index of {path.name}, got something else; import again") from error
    return Video(path, index, offset)


def _read(path: Path) -> dict[str, dict[str, Any]]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["version"] != VERSION:
            raise UserError(f"{path}: expected version {VERSION}, got {content['version']}; import again")
        return dict(content["cameras"])
    except FileNotFoundError:
        return {}
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(
            f"{path}: expected the list of this capture's videos, got something else; import again"
        ) from error
