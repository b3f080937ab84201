"""Cache on disk for the indices of videos, because creating an index reads the whole video."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from fourd.base.processes.isolation import ParserProcess
from fourd.base.progress import Track
from fourd.recording.capture.layout import VIDEOS, camera_folders, find_videos, refuse_symlinks
from fourd.recording.capture.video import VideoIndex
from fourd.recording.capture.video_list import (
    CACHE,
    NAME,
    is_entry_current,
    is_outdated,
    load_video,
    make_entry,
    read_entries,
    write_entries,
)


def cached_indices(files: Mapping[str, Path], folder: Path, track: Track) -> dict[str, VideoIndex]:
    """Return the indices of the videos, keyed by camera name, from the cache file ``folder``/.fourd/videos.json.
    Missing indices are created, and each new index is immediately written to the cache file.

    Args:
        files: path of each video by camera name.
        folder: the capture's folder.
        track: progress callback.

    Raises:
        UserError: if a video cannot be used, or the cache file is damaged.
    """
    path = folder / CACHE
    known = read_entries(path)
    indices = {}
    with ParserProcess() as parser:
        for name in track(list(files), len(files), "videos") if files else ():
            video = load_video(path, files[name], known.get(name), parser)
            if not is_entry_current(known.get(name), files[name]):
                refuse_symlinks(folder, path)
                known[name] = make_entry(video)
                write_entries(path, known)
            indices[name] = video.index
    return indices


def index_capture(capture: Path, names: Sequence[str] | None, track: Track) -> None:
    """Index the videos of a capture, and store the indices in the cache file ``capture``/.fourd/videos.json. Videos
    in the capture's video list ``capture``/videos.json are skipped, because the list already contains their indices,
    unless an older version of fourd has written them.

    When all indices are stored, opening the capture does not read whole videos. The function does nothing if the
    capture has image files or its folder is not writable.

    Args:
        capture: the capture's folder.
        names: names of the cameras whose videos are indexed, or None for all cameras.
        track: progress callback.

    Raises:
        UserError: if a video cannot be used, or the video list or the cache file is damaged.
    """
    if camera_folders(capture / "images") or not os.access(capture, os.W_OK):
        return
    known = {name: entry for name, entry in read_entries(capture / NAME).items() if not is_outdated(entry)}
    files = {name: path for name, path in find_videos(capture / VIDEOS).items() if name not in known}
    cached_indices({name: path for name, path in files.items() if names is None or name in names}, capture, track)
