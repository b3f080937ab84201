"""What importers do alike: finding each camera's frames and mattes, and checking what a file says of a lens."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Camera
from fourd.capture.layout import camera_folders, find_pictures, find_videos, frame_order
from fourd.errors import UserError
from fourd.importing.formats.imported import Frames, ImportedCamera, PictureFiles, VideoFile

Array = NDArray[np.float64]

TOO_LARGE = 1e100
"""Numbers whose products may not be finite are told as if they were not finite themselves."""
PLACES = (".", "videos", "images", "raw-2d", "videos-raw")
"""Folders of a source in which cameras are looked for, in this order; the last two are anipose's."""


def entries(folder: Path) -> list[str]:
    """Names in ``folder``, sorted; none where it cannot be listed."""
    try:
        return sorted(os.listdir(folder))
    except (OSError, ValueError):
        return []


def first_bytes(path: Path, count: int) -> bytes:
    """The first ``count`` bytes of a file, or as many as it has; none where it cannot be read."""
    try:
        with open(path, "rb") as file:
            return file.read(count)
    except (OSError, ValueError):
        return b""


def whole_file(path: Path) -> bytes:
    """All of a file. Raises UserError where it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: expected a file, got '{error.strerror}'; copy it again") from error


def frames_in(source: Path, places: Sequence[str] = PLACES) -> dict[str, Frames]:
    """Each camera's frames by its name: the videos, or the folders of pictures, of the first place that has any.

    Raises:
        UserError: when two cameras have one name, or no place has any.
    """
    for place in places:
        folder = source / place
        videos = find_videos(folder)
        if videos:
            return {name: VideoFile(path) for name, path in videos.items()}
        found: dict[str, Frames] = {}
        for name in camera_folders(folder):
            frames = picture_files(folder / name)
            if frames is not None:
                found[name] = frames
        if found and (place != "." or not set(found) & set(PLACES)):
            return found
    raise UserError(
        f"{source}: expected a video or a folder of pictures for each camera, there or in "
        f"{' or '.join(f'{place}/' for place in places if place != '.')}, got none; put them there"
    )


def picture_files(folder: Path) -> PictureFiles | None:
    """A folder's pictures in the order of their numbers; None where it has none."""
    by_stem = find_pictures(folder)
    if not by_stem:
        return None
    return PictureFiles(tuple(folder / by_stem[stem] for stem in frame_order(set(by_stem))))


def mattes_in(folder: Path, frames: Frames) -> PictureFiles | None:
    """A camera's mattes, one for each of its pictures: those of the same numbers. None where the folder has none.

    Of a video, all that the folder has: how many frames a video has is not known here.

    Raises:
        UserError: when a picture has no matte.
    """
    found = picture_files(folder)
    if found is None or not isinstance(frames, PictureFiles):
        return found
    by_number = {_number(path.stem): path for path in found.paths}
    wanted = [_number(path.stem) for path in frames.paths]
    if None not in wanted and len(set(wanted)) == len(wanted) and len(by_number) == len(found.paths):
        for number, path in zip(wanted, frames.paths, strict=True):
            if number not in by_number:
                raise UserError(
                    f"{folder}: expected a matte for each picture, got none for {path.name}; "
                    "restore it, or move the mattes away"
                )
        return PictureFiles(tuple(by_number[number] for number in wanted))
    if len(found.paths) != len(frames.paths):
        raise UserError(
            f"{folder}: expected a matte for each of {len(frames.paths)} pictures, got {len(found.paths)}; "
            "restore them, or move the mattes away"
        )
    return found


def matched(calibrated: Sequence[str], found: Iterable[str], calibration: Path) -> dict[str, str]:
    """The calibration's name of each camera found: the same name, or else the only one of the same number.

    Returns a dict from the name of the frames to the name in the calibration, for those that have one; which
    cameras lack one is for the caller to say.

    Raises:
        UserError: when no camera has a calibration.
    """
    names = list(found)
    pairs = {name: name for name in names if name in calibrated}
    if not pairs:
        by_number = {_number(name): name for name in calibrated if _number(name) is not None}
        if len(by_number) == len(calibrated):
            pairs = {name: by_number[_number(name)] for name in names if _number(name) in by_number}
        if len(set(pairs.values())) != len(pairs):
            pairs = {}
    if not pairs:
        raise UserError(
            f"{calibration}: expected calibrations named as the cameras ({', '.join(names)}), "
            f"got {', '.join(calibrated)}; rename the videos or the calibrations"
        )
    return pairs


def with_lenses(
    frames: Mapping[str, Frames], lenses: Mapping[str, Camera], calibration: Path, mattes: Sequence[Path] = ()
) -> tuple[tuple[ImportedCamera, ...], list[str]]:
    """The cameras of ``frames`` with the lenses of ``matched``, and notes on those that lack something.

    ``mattes`` are folders in which a camera's folder of mattes is looked for; the first that has some counts.
    Raises UserError as matched and mattes_in.
    """
    pairs = matched(list(lenses), frames, calibration)
    cameras = []
    for name, found in frames.items():
        masks = (mattes_in(folder / name, found) for folder in mattes)
        first = next((some for some in masks if some is not None), None)
        cameras.append(ImportedCamera(name, lenses[pairs[name]] if name in pairs else None, found, first))
    notes = []
    left = sorted(set(lenses) - set(pairs.values()))
    if left:
        notes.append(f"left out, since there are no pictures of them: {', '.join(left)}")
    bare = [name for name in frames if name not in pairs]
    if bare:
        notes.append(f"without calibration: {', '.join(bare)}")
    unmasked = [camera.name for camera in cameras if camera.masks is None]
    if 0 < len(unmasked) < len(cameras):
        notes.append(f"without mattes, which others have: {', '.join(unmasked)}")
    return tuple(cameras), notes


def numbers(where: str, value: object, shape: tuple[int, ...]) -> Array:
    """Finite numbers of that shape (-1 for any length) from what a parser made of a file.

    Raises:
        UserError: beginning with ``where``.
    """
    wanted = " x ".join("some" if size < 0 else str(size) for size in shape) or "1"
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise UserError(f"{where}: expected {wanted} numbers, got something else; calibrate again") from error
    if array.ndim != len(shape) or any(size not in (-1, got) for size, got in zip(shape, array.shape, strict=True)):
        got = " x ".join(map(str, array.shape)) or "1"
        raise UserError(f"{where}: expected {wanted} numbers, got {got}; calibrate again")
    if not (np.abs(array) < TOO_LARGE).all():
        raise UserError(f"{where}: expected finite numbers, got {array.ravel().tolist()}; calibrate again")
    return array


def lens(
    where: str,
    intrinsics: Array,
    rotation: Array,
    translation: Array,
    size: tuple[float, float],
    distortion: Array | None = None,
) -> Camera:
    """A Camera of ``size`` (width, height) whose faults are UserErrors that begin with ``where``."""
    if not np.allclose(intrinsics[2], (0, 0, 1)):
        raise UserError(f"{where}: expected a last row of 0 0 1, got {intrinsics[2].tolist()}; calibrate again")
    try:
        return Camera(intrinsics, rotation, translation, round(size[0]), round(size[1]), distortion)
    except ValueError as error:
        raise UserError(f"{where}: {error}; calibrate that camera again") from error


def _number(name: str) -> int | None:
    digits = re.findall(r"\d+", name)
    return int(digits[-1]) if digits else None
