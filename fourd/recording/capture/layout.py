"""Layout of a capture on disk: where the images, mattes and videos of each camera are, and how they are named."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence, Set
from decimal import Decimal
from difflib import get_close_matches
from pathlib import Path

from fourd.base.errors import UserError
from fourd.base.files import list_folder, resolved, sort_names

COMMON_SUFFIXES = (".jpg", ".jpeg", ".png")
PICTURE_SUFFIXES = (*COMMON_SUFFIXES, ".bmp", ".tif", ".tiff", ".webp")
"""Suffixes of image files. If a folder has two files for a frame, and only one of them is a JPEG or PNG file, that file
is used: the other one is often the same image as the camera stored it."""
DECIMAL = re.compile(r"[0-9]+\.[0-9]+|[0-9]+")
VIDEO_SUFFIXES = (
    *(".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v"),
    *(".mts", ".m2ts", ".m2t", ".ts", ".mpg", ".mpeg"),
)

INTRINSICS_NAME = "intri.yml"
EXTRINSICS_NAME = "extri.yml"
VIDEOS = "videos"
"""Folder in a capture with one video per camera: CAM.mp4, or CAM with another suffix from VIDEO_SUFFIXES."""

DERIVED = Path(".fourd")
"""Folder in a capture for all files that fourd computes from the capture. fourd deletes stale files in this folder."""

MATTES = DERIVED / "mattes"
"""Folder in a capture for generated mattes CAM/FRAME.png, which match the undistorted images."""


def camera_folders(folder: Path) -> list[str]:
    """Return the names of the camera folders in ``folder`` in natural order (cam2 before cam10); an empty list if
    ``folder`` does not exist."""
    if not folder.is_dir():
        return []
    return sort_names(entry.name for entry in os.scandir(folder) if entry.is_dir() and not entry.name.startswith("."))


def find_pictures(folder: Path) -> dict[str, str]:
    """Return the file names of a camera's images in ``folder`` in natural order, keyed by the file name without suffix.

    A mask called FRAME.jpg.png, as COLMAP expects it, has the key FRAME.

    Raises:
        UserError: if two files belong to the same frame.
    """
    found: dict[str, str] = {}
    for entry in list_folder(folder) if folder.is_dir() else []:
        stem, suffix = os.path.splitext(entry)
        if suffix.lower() not in PICTURE_SUFFIXES:
            continue
        inner, inner_suffix = os.path.splitext(stem)
        stem = inner if inner_suffix.lower() in PICTURE_SUFFIXES else stem
        common = [name for name in (found.get(stem, entry), entry) if Path(name).suffix.lower() in COMMON_SUFFIXES]
        if stem in found and len(common) != 1:
            raise UserError(
                f"{folder / entry}: expected one image per frame, got {found[stem]} for the same frame; remove one of "
                "the two files"
            )
        found[stem] = common[0] if stem in found else entry
    return found


def no_pictures_error(folder: Path) -> UserError:
    """Create the error for a camera's folder without images. The message names the suffixes of other files in it."""
    suffixes = sort_names({Path(name).suffix for name in list_folder(folder)} - {""}) if folder.is_dir() else []
    got = f"only {', '.join(suffixes[:5])} files; convert them to PNG" if suffixes else "none; restore them"
    return UserError(f"{folder}: expected images ({', '.join(PICTURE_SUFFIXES)}), got {got}")


def find_videos(folder: Path) -> dict[str, Path]:
    """Return the paths of the videos in ``folder`` in natural order, keyed by camera name, which is the file name
    without suffix.

    Raises:
        UserError: if two videos have the same camera name.
    """
    found: dict[str, Path] = {}
    for entry in list_folder(folder) if folder.is_dir() else []:
        path = folder / entry
        if path.suffix.lower() not in VIDEO_SUFFIXES or not path.is_file():
            continue
        if path.stem in found:
            raise UserError(
                f"{path}: expected one video per camera, got {found[path.stem].name} for the same camera; rename one "
                "of the two files"
            )
        found[path.stem] = path
    return found


def camera_names(capture: Path) -> list[str]:
    """Return the names of all cameras of a capture in natural order: those of its folders of images, or else of its
    videos."""
    return camera_folders(capture / "images") or list(find_videos(capture / VIDEOS))


def refuse_symlinks(capture: Path, folder: Path) -> None:
    """Check that a deletion in ``folder`` cannot reach files outside CAPTURE/.fourd through a symbolic link.

    The check is skipped if ``folder`` is not inside CAPTURE/.fourd.

    Raises:
        UserError: if CAPTURE/.fourd is a symbolic link or contains one. The message names the first symbolic link.
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
            f"{link}: expected no symbolic links in {derived}, because fourd deletes stale files there, got a link to "
            f"{os.readlink(link)}; remove the link"
        )


def sample_indices(count: int, max_samples: int) -> list[int]:
    """Return at most ``max_samples`` evenly spaced indices from 0 to ``count`` - 1, including both ends."""
    import numpy as np

    return sorted({round(index) for index in np.linspace(0, count - 1, min(count, max_samples))})


def frame_name(number: int) -> str:
    """Return the name of the video frame with this number, counted from 0."""
    return f"{number:06d}"


def sort_frames(stems: Iterable[str]) -> list[str]:
    """Sort frame names: by value if all names are decimal numbers such as 0.25, otherwise in natural order (frame_2
    before frame_10)."""
    names = list(stems)
    if all(DECIMAL.fullmatch(name) for name in names):
        return sorted(names, key=lambda name: (Decimal(name), name))
    return sort_names(names)


def missing_frame_error(folder: Path, found: Mapping[str, str], frames: Sequence[str]) -> UserError | None:
    """Create the error for the first missing frame in a camera's folder; return None if no frame is missing.

    ``frames`` contains the names of all frames. ``found`` maps the names of the frames in ``folder`` to file names.
    """
    missing = [stem for stem in frames if stem not in found]
    if not missing:
        return None
    suffix = Counter(Path(name).suffix for name in found.values()).most_common(1)
    name = f"{missing[0]}{suffix[0][0] if suffix else '.png'}"
    more = f" ({len(missing) - 1} more files are missing in this folder)" if len(missing) > 1 else ""
    return UserError(
        f"{folder / name}: expected an image, since other cameras have this frame, got no such file{more}; restore the "
        "file, exclude the frame with --frames or the camera with --views, or leave out such frames with fourd import"
    )


def parse_frame_range(text: str | None, count: int, source: str = "capture", option: str = "--frames") -> range:
    """Parse a frame range ``A:B[:S]``: every S-th frame from A to B - 1.

    A and B are optional. A defaults to the first frame, and B defaults to the number of frames.

    Args:
        text: the option's value, or None for all frames.
        count: number of frames.
        source: word for the container of the frames in error messages, such as "capture".
        option: name of the option in error messages.

    Raises:
        UserError: if the text is not a valid range, or selects no frame.
    """
    if text is None:
        return range(count)
    parts = text.split(":")
    try:
        numbers = [int(part) if part.strip() else None for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3) or (len(numbers) == 3 and (numbers[2] is None or numbers[2] < 1)):
        raise UserError(f"{option}: expected A:B or A:B:S with S at least 1 (such as 0:24 or 0:100:5), got '{text}'")
    start, stop = numbers[0] or 0, numbers[1]
    if start < 0 or start >= count or (stop is not None and not start < stop <= count):
        raise UserError(
            f"{option}: expected A:B with 0 <= A < B <= {count}, since the {source} has {count} frames, got '{text}'"
        )
    return range(count)[slice(*numbers)]


def select_views(views: Sequence[str] | None, names: Sequence[str], option: str = "--views") -> list[str]:
    """Return the names of the selected cameras in the order of ``names``. If ``views`` is None, all cameras are
    selected. A number also selects the only camera with this number as its name: 0 selects 00. If every name has a
    minus sign in front, as in -05, all cameras except the named ones are selected. No camera name starts with one.

    Raises:
        UserError: if a name is unknown, no camera is selected, or there is none. For an unknown name, the message
            suggests the most similar camera name.
    """
    if views is None:
        return list(names)
    if views and all(view.startswith("-") for view in views):
        left_out = select_views([view[1:] for view in views], names, "--exclude-views")
        if len(left_out) == len(names):
            raise UserError("--exclude-views: expected at least one camera that is left, got all cameras; name fewer")
        return [name for name in names if name not in left_out]
    if not names:
        raise UserError(
            f"{option}: expected a capture with cameras, got one without; a capture has images/CAM/, intri.yml and "
            "extri.yml (fourd import makes one from other recordings)"
        )
    views = [_by_number(view, names) for view in views]
    for view in views:
        if view not in names:
            near = get_close_matches(view, names, 1, 0.0)
            raise UserError(
                f"{option}: expected camera names among {', '.join(names)}, got '{view}'; did you mean '{near[0]}'?"
            )
    if not views:
        raise UserError(f"{option}: expected at least one camera name, got no names; give one of {', '.join(names)}")
    return [name for name in names if name in views]


def _by_number(view: str, names: Sequence[str]) -> str:
    """Return the name of the only camera with the same number as ``view``, such as 07 for 7, or ``view`` itself."""
    if view in names or not (view.isascii() and view.isdecimal()):
        return view
    equal = [name for name in names if name.isascii() and name.isdecimal() and name.lstrip("0") == view.lstrip("0")]
    return equal[0] if len(equal) == 1 else view


def link_entries(capture: Path, target: Path, *, left_out: Set[str]) -> None:
    """Create symbolic links in ``target`` to the files and folders directly in ``capture``, except those named in
    ``left_out``.

    Existing links are kept.
    """
    for name in sort_names(os.listdir(capture)):
        link = target / name
        if name not in left_out and not link.is_symlink():
            link.symlink_to(resolved(capture / name))
