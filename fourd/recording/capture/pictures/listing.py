"""Lists the images and masks of a capture by frame."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from fourd.base.errors import UserError
from fourd.recording.capture.layout import camera_folders, find_pictures
from fourd.recording.capture.pictures.alpha import alpha_is_matte, has_alpha_channel
from fourd.recording.capture.pictures.moments import match_frames, match_masks


def list_images(folder: Path, names: Sequence[str]) -> dict[str, dict[str, str]]:
    """List the image files of the cameras ``names`` in the folder images/.

    The frames are those of :func:`~fourd.recording.capture.pictures.moments.match_frames` for all cameras in the
    folder, so that the names of the frames do not depend on the selected cameras.

    Returns:
        For each camera, a dictionary from frame names to file names.

    Raises:
        UserError: if two files of a camera in ``names`` belong to the same frame.
    """
    found = {name: find_pictures(folder / name) for name in names}
    for name in camera_folders(folder):
        if name not in found:
            # Errors in the folders of cameras that are not selected do not matter.
            with suppress(UserError):
                found[name] = find_pictures(folder / name)
    matched = match_frames({name: files for name, files in found.items() if files})
    return {name: {frame: found[name][stem] for frame, stem in matched.get(name, {}).items()} for name in names}


def masked_cameras(capture: Path) -> list[str]:
    """Return the names of the cameras of which the user provided masks: files in masks/, or alpha channels.

    Raises:
        UserError: if an examined image is damaged.
    """
    if alpha_is_matte(capture):
        folder = capture / "images"
        pictures = {name: next(iter(find_pictures(folder / name).values()), None) for name in camera_folders(folder)}
        return [name for name, file in pictures.items() if file is not None and has_alpha_channel(folder / name / file)]
    masks = capture / "masks"
    return [name for name in camera_folders(masks) if find_pictures(masks / name)]


def list_masks(folder: Path, frames: Sequence[str]) -> dict[str, str]:
    """List the mask files in a camera's folder, keyed by frame name; see
    :func:`~fourd.recording.capture.pictures.moments.match_masks`.

    Raises:
        UserError: if two files belong to the same frame.
    """
    found = find_pictures(folder)
    return {frame: found[stem] for frame, stem in match_masks(found, frames).items()}
