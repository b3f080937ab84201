"""Cached video indices, so that each video is read through once across all commands."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from fourd.capture.layout import VIDEOS, camera_folders, find_videos, refuse_symlinks
from fourd.capture.video import VideoIndex
from fourd.capture.video_list import CACHE, NAME, is_entry_current, load_video, make_entry, read_entries, write_entries
from fourd.progress import Track


def cached_indices(files: Mapping[str, Path], folder: Path, track: Track) -> dict[str, VideoIndex]:
    """The indices of videos by camera, from ``folder``/.fourd/videos.json.

    Videos that the file lacks are indexed, and added to it one by one.

    Args:
        files: videos by camera.
        folder: the capture's folder.
        track: wraps loops for progress.

    Raises:
        UserError: when a video cannot be used, or the file is damaged.
    """
    path = folder / CACHE
    known = read_entries(path)
    indices = {}
    for name in track(list(files), len(files), "videos") if files else ():
        video = load_video(path, files[name], known.get(name))
        if not is_entry_current(known.get(name), files[name]):
            refuse_symlinks(folder, path)
            known[name] = make_entry(video)
            write_entries(path, known)
        indices[name] = video.index
    return indices


def index_capture(capture: Path, names: Sequence[str] | None, track: Track) -> None:
    """Index and cache the videos of a capture without videos.json, so that opening it does not read them through.

    Does nothing where the capture has pictures or its folder is not writable. Raises UserError as cached_indices.
    """
    if camera_folders(capture / "images") or not os.access(capture, os.W_OK):
        return
    known = read_entries(capture / NAME)
    files = {name: path for name, path in find_videos(capture / VIDEOS).items() if name not in known}
    cached_indices({name: path for name, path in files.items() if names is None or name in names}, capture, track)
