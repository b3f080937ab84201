"""Reads videos through once: what was found is kept, however often commands are stopped and called again."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from fourd.capture.layout import VIDEOS, camera_folders, find_videos, refuse_symlinks
from fourd.capture.video import VideoIndex
from fourd.capture.video_list import KEPT, NAME, entry_of, is_of, listed, read_entries, write_entries
from fourd.progress import Track


def kept_indices(files: Mapping[str, Path], folder: Path, track: Track) -> dict[str, VideoIndex]:
    """Where the frames of videos lie, as ``folder``/.fourd/videos.json has it.

    What it lacks is found now, and written there video by video.

    Args:
        files: videos by camera.
        folder: of the capture.
        track: for progress.

    Raises:
        UserError: when a video cannot be used, or that file is damaged.
    """
    listing = folder / KEPT
    known = read_entries(listing)
    indices = {}
    for name in track(list(files), len(files), "videos") if files else ():
        video = listed(listing, files[name], known.get(name))
        if not is_of(known.get(name), files[name]):
            refuse_symlinks(folder, listing)
            known[name] = entry_of(video)
            write_entries(listing, known)
        indices[name] = video.index
    return indices


def index_capture(capture: Path, names: Sequence[str] | None, track: Track) -> None:
    """Index the videos of a capture that came without videos.json, so that opening it does not read them again.

    Nothing is done where the capture has pictures or its folder cannot be written to. Raises UserError as kept_indices.
    """
    if camera_folders(capture / "images") or not os.access(capture, os.W_OK):
        return
    known = read_entries(capture / NAME)
    files = {name: path for name, path in find_videos(capture / VIDEOS).items() if name not in known}
    kept_indices({name: path for name, path in files.items() if names is None or name in names}, capture, track)
