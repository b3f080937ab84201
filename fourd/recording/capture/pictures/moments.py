"""Decides from the names of image files which images of different cameras were taken at the same moment.

Images are never paired by their positions in the folders, because one lost file would shift all later ones.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence

from fourd.base.formats.frame_numbers import varying_numbers_of
from fourd.recording.capture.layout import frame_name, sort_frames

MASK_WORD = re.compile(r"[-_. ]?(?:masks?|mattes?|alpha)", re.IGNORECASE)


def match_frames(stems: Mapping[str, Collection[str]], *, renumber: bool = False) -> dict[str, dict[str, str]]:
    """Match the images of several cameras by their file names without suffix.

    The first of these rules that applies gives the names of the frames:
    - all cameras have the same file names. These are the frames' names;
    - in the file names of each camera, one number varies, as in cam1_000123 and cam2_000123, or frame_1 and img_0001.
      Images with the same number belong to the same frame. If every number is written in only one way, the file names
      are the frames' names; otherwise, the frames are named after their numbers;
    - the file names are the frames' names.

    Args:
        stems: file names without suffix of each camera's images.
        renumber: whether to name the frames after their numbers, such as 000123, if the names have such numbers.

    Returns:
        For each camera, a dictionary from the names of its frames to its file names without suffix. Cameras may lack
        frames that other cameras have.
    """
    listed = {camera: sort_frames(names) for camera, names in stems.items()}
    is_same = len({frozenset(names) for names in listed.values()}) <= 1
    numbers = varying_numbers_of(listed) if renumber or not is_same else None
    if numbers is None:
        return {camera: {stem: stem for stem in names} for camera, names in listed.items()}
    spellings: dict[int, set[str]] = {}
    for camera, names in listed.items():
        for number, stem in zip(numbers[camera], names, strict=True):
            spellings.setdefault(number, set()).add(stem)
    if not renumber and all(len(each) == 1 for each in spellings.values()):
        return {camera: {stem: stem for stem in names} for camera, names in listed.items()}
    return {
        camera: {frame_name(number): stem for number, stem in sorted(zip(numbers[camera], names, strict=True))}
        for camera, names in listed.items()
    }


def match_masks(stems: Collection[str], frames: Sequence[str]) -> dict[str, str]:
    """Match a camera's masks to its frames by the number that varies in the names, as in mask_0001 and frame_000001,
    or else by name, without the word mask.

    Args:
        stems: file names of the masks without suffix.
        frames: names of the frames.

    Returns:
        File names of masks, keyed by frame name. Masks that belong to no frame keep their own names as keys, so that a
        missing or surplus mask can be named.
    """
    by_name = {stem: stem for stem in sort_frames(stems)}
    numbers = varying_numbers_of({"masks": list(by_name), "frames": list(frames)})
    if numbers is None:
        own = {MASK_WORD.sub("", stem): stem for stem in by_name}
        return own if set(own) == set(frames) else by_name
    frame_of = dict(zip(numbers["frames"], frames, strict=True))
    return {frame_of.get(number, stem): stem for number, stem in zip(numbers["masks"], by_name, strict=True)}
