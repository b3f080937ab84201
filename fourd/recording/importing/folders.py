"""Helpers of the importers: find the frames and mattes of each camera, and check the values of calibration files."""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Camera
from fourd.base.errors import UserError
from fourd.base.files import sort_names
from fourd.base.formats.frame_numbers import varying_numbers
from fourd.base.limits import open_regular, read_limited
from fourd.recording.capture.calibration import camera_name_problem
from fourd.recording.capture.layout import camera_folders, find_pictures, find_videos, frame_name, sort_frames
from fourd.recording.capture.pictures.moments import match_masks
from fourd.recording.importing.imported import Frames, ImportedCamera, PictureFiles, VideoFile

Array = NDArray[np.float64]

MAX_VALUE = 1e100
"""Maximum magnitude of a number in a calibration file. Larger numbers are treated as infinite, because their products
may overflow."""
FRAME_FOLDERS = (".", "videos", "images", "raw-2d", "videos-raw", "synchronized_videos")
"""Folders of a source that may contain the cameras' frames, in order of preference. Anipose uses the folders raw-2d and
videos-raw. FreeMoCap uses the folder synchronized_videos."""
CALIBRATION_FOLDER = re.compile("calib|intri|extri", re.IGNORECASE)
"""Pattern of the names of calibration folders. Images and videos in calibration folders show calibration boards, not
the recording."""


def list_entries(folder: Path) -> list[str]:
    """Return the names in ``folder`` in natural order. The list of names is empty if the folder cannot be read."""
    try:
        return sort_names(os.listdir(folder))
    except (OSError, ValueError):
        return []


def read_head(path: Path, count: int) -> bytes:
    """Read up to ``count`` bytes from the start of a file. Returns empty bytes if the file cannot be read."""
    try:
        with open_regular(path) as file:
            return file.read(count)
    except (OSError, ValueError):
        return b""


def read_file(path: Path) -> bytes:
    """Read the content of a file. Raises UserError if the file cannot be read."""
    try:
        return read_limited(path)
    except OSError as error:
        raise UserError(f"{path}: expected a file, got '{error.strerror}'; copy it again") from error


def find_frames(source: Path, folders: Sequence[str] = FRAME_FOLDERS, names: Collection[str] = ()) -> dict[str, Frames]:
    """Find the frames of each camera: a video, a folder of images, or a folder with one video.

    Only the first of ``folders`` that contains any frames is used. Returns the frames, keyed by camera name.

    Args:
        source: the folder of the recording.
        folders: folders in ``source`` that may contain the frames, in order of preference.
        names: names of the calibrated cameras, if they are known. Folders with these names are cameras. Without them, a
            folder with one video is a camera only if the video's name contains the folder's name.

    Raises:
        UserError: when two cameras have the same name, or no folder has frames.
    """
    for folder_name in folders:
        folder = source / folder_name
        videos = find_videos(folder)
        if videos:
            return {name: VideoFile(path) for name, path in videos.items()}
        found: dict[str, Frames] = {}
        for name in camera_folders(folder):
            if CALIBRATION_FOLDER.search(name):
                continue
            frames = picture_files(folder / name)
            if frames is not None:
                found[name] = frames
        if found and (folder_name != "." or not set(found) & set(FRAME_FOLDERS)):
            return found
    for folder_name in folders:
        found = _folders_with_one_video(source / folder_name, names)
        if found:
            return found
    raise UserError(
        f"{source}: expected a video or a folder of images for each camera, in this folder or in "
        f"{' or '.join(f'{name}/' for name in folders if name != '.')}, got none; add the videos or images"
    )


def _folders_with_one_video(folder: Path, names: Collection[str]) -> dict[str, Frames]:
    """Find the cameras in the layout CAM/any_CAM.mp4. The result is empty unless each folder that contains videos
    contains one, and is a camera by its name or by the name of its video."""
    found: dict[str, Frames] = {}
    for child in camera_folders(folder):
        if child in FRAME_FOLDERS or CALIBRATION_FOLDER.search(child):
            continue
        videos = find_videos(folder / child)
        if len(videos) > 1:
            return {}
        for stem, path in videos.items():
            if child not in names and not (_ends_with(stem, child) or _starts_with(stem, child)):
                return {}
            found[child] = VideoFile(path)
    return found if len(found) > 1 else {}


def picture_files(folder: Path) -> PictureFiles | None:
    """Return the images in a folder, ordered by frame number, or None if the folder has no images."""
    by_stem = find_pictures(folder)
    if not by_stem:
        return None
    stems = sort_frames(by_stem)
    return PictureFiles(tuple(folder / by_stem[stem] for stem in stems), tuple(stems))


def find_mattes(folder: Path, frames: Frames) -> PictureFiles | None:
    """Find the mattes of a camera. Mattes and images are matched by the number that varies in their file names, or else
    by name. Returns None if the folder has no mattes.

    For a video, all mattes in the folder are returned, because the video's number of frames is not known here.

    Raises:
        UserError: when an image has no matte, or the mattes of a video are not numbered from 0 or 1 without gaps.
    """
    found = picture_files(folder)
    if found is None:
        return None
    if not isinstance(frames, PictureFiles):
        return _mattes_of_video(folder, found)
    path_of = dict(zip(found.names, found.paths, strict=True))
    matched = match_masks(found.names, frames.names)
    for name, path in zip(frames.names, frames.paths, strict=True):
        if name not in matched:
            raise UserError(
                f"{folder}: expected a matte for each image, got none for {path.name}; "
                "restore the matte, or move all mattes away"
            )
    return PictureFiles(tuple(path_of[matched[name]] for name in frames.names), frames.names)


def _mattes_of_video(folder: Path, found: PictureFiles) -> PictureFiles:
    """Return the mattes of a video's frames, named after the numbers of the frames."""
    numbers = varying_numbers(found.names)
    if len(found.names) > 1 and (numbers is None or numbers != list(range(numbers[0], numbers[0] + len(numbers)))):
        gap = next((n for n in range(min(numbers), max(numbers)) if n not in numbers), None) if numbers else None
        got = "other names" if gap is None else f"no matte of frame {gap}"
        raise UserError(
            f"{folder}: expected a matte of each video frame, numbered without gaps, got {got}; restore the mattes, or "
            "move all mattes away"
        )
    if numbers is not None and numbers[0] > 1:
        raise UserError(
            f"{folder}: expected a matte of each video frame, numbered from 0 or 1, got {found.paths[0].name} first; "
            "restore the mattes, or move all mattes away"
        )
    return PictureFiles(found.paths, tuple(frame_name(index) for index in range(len(found.paths))))


def check_names(names: Sequence[str]) -> None:
    """Raise UserError if a camera name is not valid, or two cameras have the same name. See
    :func:`fourd.recording.capture.calibration.camera_name_problem`."""
    seen: set[str] = set()
    for name in names:
        problem = camera_name_problem(name)
        if problem is not None:
            raise UserError(f"camera {name!a}: {problem}; rename it")
        if name in seen:
            raise UserError(f"camera '{name}': expected each camera once, got two with this name; rename one")
        seen.add(name)


def match_names(calibrated: Sequence[str], found: Iterable[str], calibration: Path) -> dict[str, str]:
    """Match the names of the cameras that have frames to the names in the calibration.

    The first of these rules that gives a match is used:
    - the names are equal, whether accented letters are composed or decomposed;
    - the numbers of the cameras are equal. The number of a camera is the only number that differs between the names, or
      else the last number of its name. This rule is used only if all calibrations have different numbers;
    - the camera's name ends with a separator, optionally "cam", and the calibration's name, as in
      2019-08-02-vid01-camA for the calibration A.

    Returns the calibration's name for each camera in ``found`` that has a calibration.

    Raises:
        UserError: when no camera has a calibration, or several videos have the same calibration.
    """
    names = list(found)
    # Programs on a Mac decompose accented letters in file names, and other programs compose them.
    by_text = {unicodedata.normalize("NFC", own): own for own in calibrated}
    composed = {name: unicodedata.normalize("NFC", name) for name in names}
    pairs = {name: by_text[text] for name, text in composed.items() if text in by_text}
    if not pairs:
        by_number = {number: name for name, number in _camera_numbers(calibrated).items()}
        if len(by_number) == len(calibrated):
            pairs = {name: by_number[number] for name, number in _camera_numbers(names).items() if number in by_number}
        if len(set(pairs.values())) != len(pairs):
            pairs = {}
    if not pairs:
        pairs = {name: own for name in names for own in calibrated if _ends_with(name, own)}
        repeated = [own for own in calibrated if list(pairs.values()).count(own) > 1]
        if repeated:
            videos = [name for name, own in pairs.items() if own == repeated[0]]
            raise UserError(
                f"{calibration}: expected one video of camera '{repeated[0]}', got {', '.join(videos)}; import a "
                "folder with one recording"
            )
    if not pairs:
        raise UserError(
            f"{calibration}: expected calibrations with the names of the cameras ({', '.join(names)}), "
            f"got {', '.join(calibrated)}; rename the videos or the calibrations"
        )
    return pairs


def join_calibrations(
    frames: Mapping[str, Frames], calibrations: Mapping[str, Camera], path: Path, mattes: Sequence[Path] = ()
) -> tuple[tuple[ImportedCamera, ...], list[str]]:
    """Combine frames and calibrations, matched by :func:`match_names`. Returns the cameras, and notes about cameras
    without images, calibration or mattes.

    Args:
        frames: frames, keyed by camera name.
        calibrations: cameras, keyed by their names in the file ``path``.
        path: the calibration file, for error messages.
        mattes: folders that may contain a folder of mattes for each camera. The mattes of a camera are read from the
            first folder that contains any of them.

    Raises:
        UserError: when :func:`match_names` or :func:`find_mattes` raises UserError.
    """
    pairs = match_names(list(calibrations), frames, path)
    cameras = []
    for name, found in frames.items():
        masks = (find_mattes(folder / name, found) for folder in mattes)
        first = next((some for some in masks if some is not None), None)
        cameras.append(ImportedCamera(name, calibrations[pairs[name]] if name in pairs else None, found, first))
    notes = []
    unused = sorted(set(calibrations) - set(pairs.values()))
    if unused:
        notes.append(f"cameras without images, not imported: {', '.join(unused)}")
    uncalibrated = [name for name in frames if name not in pairs]
    if uncalibrated:
        notes.append(f"without calibration: {', '.join(uncalibrated)}")
    unmasked = [camera.name for camera in cameras if camera.masks is None]
    if 0 < len(unmasked) < len(cameras):
        notes.append(f"some cameras have no mattes: {', '.join(unmasked)}")
    return tuple(cameras), notes


def parse_numbers(where: str, value: object, shape: tuple[int, ...]) -> Array:
    """Convert a parsed value to an array of finite numbers with the shape ``shape``.

    A size of -1 in ``shape`` means any length.

    Raises:
        UserError: when the value has a wrong shape or type. The error message starts with ``where``.
    """
    expected = " x ".join("some" if size < 0 else str(size) for size in shape) or "1"
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise UserError(f"{where}: expected {expected} numbers, got something else; calibrate again") from error
    if array.ndim != len(shape) or any(size not in (-1, got) for size, got in zip(shape, array.shape, strict=True)):
        got = " x ".join(map(str, array.shape)) or "1"
        raise UserError(f"{where}: expected {expected} numbers, got {got}; calibrate again")
    if not (np.abs(array) < MAX_VALUE).all():
        raise UserError(f"{where}: expected finite numbers, got {array.ravel().tolist()}; calibrate again")
    return array


def make_camera(
    where: str,
    intrinsics: Array,
    rotation: Array,
    translation: Array,
    size: tuple[float, float],
    distortion: Array | None = None,
) -> Camera:
    """Make a Camera from calibration values. ``size`` is the width and height of the camera's images in pixels.

    For invalid values, raises UserError with a message that starts with ``where``.
    """
    if not np.allclose(intrinsics[2], (0, 0, 1)):
        raise UserError(
            f"{where}: expected intrinsics with last row 0 0 1, got last row {intrinsics[2].tolist()}; calibrate again"
        )
    try:
        return Camera(intrinsics, rotation, translation, round(size[0]), round(size[1]), distortion)
    except ValueError as error:
        raise UserError(f"{where}: {error}; calibrate that camera again") from error


def _ends_with(name: str, camera: str) -> bool:
    """Return whether a video's name ends with a separator, optionally "cam", and the camera's name, such as -A or -camA
    for the camera A."""
    return re.search(rf"(?:^|[-_. ])(?:cam)?{re.escape(camera)}$", name) is not None


def _starts_with(name: str, camera: str) -> bool:
    """Return whether a video's name starts with the camera's name and a separator."""
    return re.match(rf"{re.escape(camera)}(?:$|[-_. ])", name) is not None


def _camera_numbers(names: Sequence[str]) -> dict[str, int]:
    """Return the numbers of cameras, keyed by name: the only number that differs between the names, if there is one, or
    else the last number in each name. Names without digits are left out."""
    runs = {name: re.findall(r"\d+", name) for name in names}
    if len({re.sub(r"\d+", "0", name) for name in names}) == 1:
        differs = [len({int(number) for number in column}) > 1 for column in zip(*runs.values(), strict=True)]
        if differs.count(True) == 1:
            return {name: int(numbers[differs.index(True)]) for name, numbers in runs.items()}
    return {name: int(numbers[-1]) for name, numbers in runs.items() if numbers}
