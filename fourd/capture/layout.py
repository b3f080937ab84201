"""Files of a capture: pictures, mattes and videos by camera and frame, found by listing folders."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from fourd.errors import UserError

PICTURE_SUFFIXES = (".jpg", ".jpeg", ".png")
VIDEO_SUFFIXES = (".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v", ".mts")

VIDEOS = "videos"
"""Folder of a capture with one video per camera, CAM.mp4 or another of VIDEO_SUFFIXES."""

DERIVED = Path(".fourd")
"""Folder of a capture for everything that fourd computes from it; fourd deletes stale files there."""

MATTES = DERIVED / "mattes"
"""Generated mattes, CAM/FRAME.png, of the undistorted pictures."""


def camera_folders(folder: Path) -> list[str]:
    """Names of the folders in ``folder``, sorted; empty where it does not exist."""
    if not folder.is_dir():
        return []
    return sorted(entry.name for entry in os.scandir(folder) if entry.is_dir() and not entry.name.startswith("."))


def find_pictures(folder: Path) -> dict[str, str]:
    """File names of a camera's pictures by stem, the frame's name.

    Raises:
        UserError: when two files share a stem.
    """
    found: dict[str, str] = {}
    for entry in sorted(os.listdir(folder)) if folder.is_dir() else []:
        stem, suffix = os.path.splitext(entry)
        if suffix.lower() not in PICTURE_SUFFIXES or entry.startswith("."):
            continue
        if stem in found:
            raise UserError(
                f"{folder / entry}: expected one picture per frame, got {found[stem]} as well; remove one of them"
            )
        found[stem] = entry
    return found


def find_videos(folder: Path) -> dict[str, Path]:
    """Paths of the videos in ``folder`` by name without suffix, sorted.

    Raises:
        UserError: when two videos have the same name without suffix.
    """
    found: dict[str, Path] = {}
    for entry in sorted(os.listdir(folder)) if folder.is_dir() else []:
        path = folder / entry
        if path.suffix.lower() not in VIDEO_SUFFIXES or entry.startswith(".") or not path.is_file():
            continue
        if path.stem in found:
            raise UserError(
                f"{path}: expected each camera once, got {found[path.stem].name} of the same name; rename one of them"
            )
        found[path.stem] = path
    return found


def refuse_symlinks(capture: Path, folder: Path) -> None:
    """Check before deleting files in ``folder`` that this deletes nothing outside CAPTURE/.fourd.

    Does nothing if ``folder`` is elsewhere.

    Raises:
        UserError: naming the first symbolic link at or below CAPTURE/.fourd.
    """
    derived = capture / DERIVED
    if not Path(os.path.abspath(folder)).is_relative_to(os.path.abspath(derived)):
        return
    entries = [derived]
    for parent, folders, files in os.walk(derived, followlinks=False):
        entries += [Path(parent, name) for name in (*folders, *files)]
    link = next((path for path in entries if path.is_symlink()), None)
    if link is not None:
        raise UserError(
            f"{link}: expected no symbolic links in {derived}, where fourd deletes stale files, got a link to "
            f"{os.readlink(link)}; remove the link"
        )


def sample_indices(count: int, max_samples: int) -> list[int]:
    """At most ``max_samples`` indices below ``count``, evenly spaced from the first to the last."""
    return sorted({round(index) for index in np.linspace(0, count - 1, min(count, max_samples))})


def frame_name(number: int) -> str:
    """The name of a frame that is known by its number alone, from 0."""
    return f"{number:06d}"


def sort_frames(stems: set[str]) -> list[str]:
    """Frame names in order: by number where all are numbers, else by name."""
    if all(stem.isdecimal() for stem in stems):
        return sorted(stems, key=lambda stem: (int(stem), stem))
    return sorted(stems)


def missing_frame_error(folder: Path, found: dict[str, str], frames: Sequence[str]) -> UserError | None:
    """The error for the first of ``frames`` that a camera's folder lacks; None if it has all."""
    missing = [stem for stem in frames if stem not in found]
    if not missing:
        return None
    suffix = Counter(Path(name).suffix for name in found.values()).most_common(1)
    name = f"{missing[0]}{suffix[0][0] if suffix else '.png'}"
    more = f" (and {len(missing) - 1} more there)" if len(missing) > 1 else ""
    return UserError(
        f"{folder / name}: expected a picture, as other cameras have of that frame, got none{more}; restore it, "
        "or leave the frames out with --frames or the camera with --views"
    )


def parse_frame_range(text: str | None, count: int, source: str = "capture") -> range:
    """The frames of ``A:B[:S]``: from A to B, B excluded, every S-th; A and B may be left out. None gives all.

    Args:
        text: the option's value.
        count: number of frames.
        source: what has these frames, for errors.

    Raises:
        UserError: when the text is no slice, or selects no frame.
    """
    if text is None:
        return range(count)
    parts = text.split(":")
    try:
        numbers = [int(part) if part.strip() else None for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3) or (len(numbers) == 3 and (numbers[2] is None or numbers[2] < 1)):
        raise UserError(f"--frames: expected A:B or A:B:S with S at least 1 (such as 0:24 or 0:100:5), got '{text}'")
    start, stop = numbers[0] or 0, numbers[1]
    if start < 0 or start >= count or (stop is not None and not start < stop <= count):
        raise UserError(
            f"--frames: expected A:B with 0 <= A < B <= {count}, since the {source} has {count} frames, got '{text}'"
        )
    return range(count)[slice(*numbers)]


def select_views(views: Sequence[str] | None, names: Sequence[str], option: str = "--views") -> list[str]:
    """The selected cameras, in the order of ``names``; all for None.

    Raises:
        UserError: for an unknown name, with the nearest known one, or an empty selection.
    """
    if views is None:
        return list(names)
    for view in views:
        if view not in names:
            near = get_close_matches(view, names, 1, 0.0)
            raise UserError(
                f"{option}: expected camera names among {', '.join(names)}, got '{view}'; did you mean '{near[0]}'?"
            )
    if not views:
        raise UserError(f"{option}: expected at least one camera name, got none")
    return [name for name in names if name in views]
