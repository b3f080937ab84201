"""Opens the images and mattes of a capture's cameras without decoding them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from fourd.base.errors import UserError, command_line
from fourd.recording.capture.camera_frames import CameraFrames, Footage, Mattes, PictureFrames
from fourd.recording.capture.decoding import decode_alpha, decode_matte, decode_picture, read_header
from fourd.recording.capture.layout import (
    MATTES,
    camera_folders,
    find_pictures,
    missing_frame_error,
    no_pictures_error,
    sort_frames,
)
from fourd.recording.capture.pictures.alpha import alpha_is_matte, has_alpha_channel
from fourd.recording.capture.pictures.listing import list_masks
from fourd.recording.capture.pictures.masks import MaskFolder


def picture_frame_names(path: Path, images: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Return the sorted names of all frames that have an image of at least one camera.

    Args:
        path: the capture's folder.
        images: file names by frame name, for each camera.

    Raises:
        UserError: if a camera has no images.
    """
    for name, files in images.items():
        if not files:
            raise no_pictures_error(path / "images" / name)
    return sort_frames(set().union(*images.values()))


def open_pictures(path: Path, name: str, files: Mapping[str, str], chosen: Sequence[str]) -> Footage:
    """Open the images of camera ``name``. ``files`` maps all its frame names to file names.

    Raises:
        UserError: if an image of the frames ``chosen`` is missing, or the first one is damaged.
    """
    folder = path / "images" / name
    error = missing_frame_error(folder, files, chosen)
    if error is not None:
        raise error
    images = [folder / files[frame] for frame in chosen]
    header = read_header(images[0])
    decode = partial(decode_picture, orientation=header.orientation)
    return Footage(PictureFrames(images, decode), None, header.size)


@dataclass(frozen=True)
class OwnMattes:
    """The user's mattes of a capture.

    Attributes:
        folder: the folder masks/.
        is_alpha: whether the alpha channels of the images are the mattes; see
            :func:`~fourd.recording.capture.pictures.alpha.alpha_is_matte`.
        frames: names of all frames of the capture.
    """

    folder: MaskFolder
    is_alpha: bool
    frames: Sequence[str]

    @property
    def exist(self) -> bool:
        """Whether the user provided mattes of any camera."""
        return self.is_alpha or bool(camera_folders(self.folder.folder))


def open_masks(path: Path, frames: Sequence[str]) -> OwnMattes:
    """Find the user's mattes of the capture ``path``, which has the frames ``frames``."""
    return OwnMattes(MaskFolder(path / "masks"), alpha_is_matte(path), frames)


def open_mattes(
    path: Path, name: str, images: CameraFrames, masks: OwnMattes, chosen: Sequence[str], partial: bool = False
) -> Mattes | None:
    """Return the user's mattes of the chosen frames, or the generated mattes, or None if there are neither.

    If the user provided mattes of other cameras, or if ``partial`` is true, generated mattes of only some of the frames
    count as no mattes.

    Raises:
        UserError: if there are mattes, but not of all frames ``chosen``.
    """
    own = path / "masks" / name
    files = list_masks(own, masks.frames)
    if files:
        error = missing_frame_error(own, files, chosen)
        if error is not None:
            raise error
        return Mattes(PictureFrames([own / files[frame] for frame in chosen], masks.folder.decode), is_generated=False)
    if masks.is_alpha and isinstance(images, PictureFrames) and has_alpha_channel(images.paths[0]):
        return Mattes(PictureFrames(images.paths, decode_alpha), is_generated=False)
    generated = path / MATTES / name
    files = find_pictures(generated)
    if not files:
        return None
    if missing_frame_error(generated, files, chosen) is not None:
        if masks.exist or partial:
            return None
        count = sum(frame in files for frame in chosen)
        raise UserError(
            f"{generated}: expected mattes of {len(chosen)} frames, got {count}; make the missing mattes with: "
            f"{command_line('fourd', 'matte', path)}"
        )
    return Mattes(PictureFrames([generated / files[frame] for frame in chosen], decode_matte), is_generated=True)
