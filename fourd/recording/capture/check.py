"""Check of a capture, which collects all errors, whereas opening a capture stops at the first one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction
from math import inf
from pathlib import Path
from typing import TypeVar

import numpy as np

from fourd.base.cameras import Camera, describe_equal_positions
from fourd.base.errors import UserError
from fourd.base.files import sort_names
from fourd.base.progress import Track, untracked
from fourd.recording.capture.calibration import Calibration, CalibrationReport, check_calibration
from fourd.recording.capture.checks.damage import Skipped, decode_pictures
from fourd.recording.capture.checks.mattes import MatteTally
from fourd.recording.capture.checks.pictures import PictureCheck, describe_gaps
from fourd.recording.capture.decoding import decode_matte, decode_picture, read_header
from fourd.recording.capture.focus import describe_inverted, find_focus
from fourd.recording.capture.frame_rate import read_rate
from fourd.recording.capture.layout import (
    MATTES,
    VIDEOS,
    camera_folders,
    find_videos,
    frame_name,
    missing_frame_error,
    no_pictures_error,
    sort_frames,
)
from fourd.recording.capture.pictures.alpha import ALPHA_NOTE, alpha_is_matte
from fourd.recording.capture.pictures.listing import list_images, list_masks, masked_cameras
from fourd.recording.capture.pictures.masks import MaskFolder
from fourd.recording.capture.split import read_test_views, require_known
from fourd.recording.capture.video_list import Video, common_frames, common_rate, list_videos

Value = TypeVar("Value")

SAMPLED_MATTES = 5
"""Minimum number of mattes per camera that a check decodes."""
MIN_CAMERAS = 2
MAX_FOCUS_MISS = 0.5
"""Maximum tangent of the angle between a camera's optical axis and the direction to the common focus, which is the
point that the cameras face.

Above this value, a warning says that the camera faces away from the focus.
"""


@dataclass(frozen=True)
class Report:
    """Content of a capture and its errors.

    Attributes:
        problems: errors that make the capture unusable, one line per error with its fix.
        warnings: content that is valid but probably a mistake, one line per mistake.
        cameras: names of the cameras that have both a calibration and images.
        frames: number of frames.
        fps: frame rate of the recording in 1/s, or None if it is not known.
        sizes: (width, height) of the images in pixels, keyed by camera name.
        has_masks: whether there are mattes.
        masked: names of the cameras of which the user provided masks.
        distorted: number of cameras with lens distortion.
        ring_radius: mean distance between the cameras and their common focus in world units; 0 if there is no common
            focus.
        coverage: mean matte value as a fraction of white, averaged over the decoded mattes, or None if no matte was
            decoded. For a binary matte, this is the fraction of the image that the subject covers.
        nbytes: total size of all images, videos and mattes in bytes.
        skipped: the files that were not decoded because decoding all of them takes too long, or None.
        notes: how unusual content is read, one line each. Notes are not mistakes.
        test_views: names of the cameras that training holds out by default, or None if the capture has no test split.
        metres_per_unit: length of a world unit in metres, or None if the calibration does not state it.
    """

    problems: tuple[str, ...]
    warnings: tuple[str, ...]
    cameras: tuple[str, ...]
    frames: int
    fps: Fraction | None
    sizes: dict[str, tuple[int, int]]
    has_masks: bool
    distorted: int
    ring_radius: float
    coverage: float | None
    nbytes: int
    skipped: Skipped | None = None
    notes: tuple[str, ...] = ()
    test_views: tuple[str, ...] | None = None
    masked: tuple[str, ...] = ()
    metres_per_unit: float | None = None


def check_capture(
    path: Path | str, *, deep: bool = False, decode_seconds: float = 0.0, track: Track = untracked
) -> Report:
    """Check the files of a capture. Errors in the files are returned in the report and not raised.

    Args:
        path: the capture's folder.
        deep: whether to decode all image files and mattes.
        decode_seconds: if ``deep`` is False, all image files and mattes are decoded only if this probably takes at most
            this number of seconds; otherwise, a sample is decoded. If it is 0, only a few mattes per camera are
            decoded. For each file that is not decoded, only the file name and the image size in the file header are
            checked.
        track: progress callback.
    """
    path = Path(path)
    if not path.is_dir():
        got = "a file" if path.exists() else "no such folder"
        problem = f"{path}: expected a capture's folder, got {got}; check the path"
        return Report((problem,), (), (), 0, None, {}, False, 0, 0.0, None, 0)
    return _Check(path, inf if deep else decode_seconds, track).report()


def first_lines(lines: Sequence[str], max_lines: int) -> Iterator[str]:
    """Yield the first ``max_lines`` lines, then one line with the number of remaining lines."""
    yield from lines[:max_lines]
    if len(lines) > max_lines:
        yield f"and {len(lines) - max_lines} more"


class _Check:
    def __init__(self, path: Path, decode_seconds: float, track: Track) -> None:
        self.path = path
        self.decode_seconds = decode_seconds
        self.track = track
        self.problems: list[str] = []
        self.warnings: list[str] = []
        self.sizes: dict[str, tuple[int, int]] = {}
        self.mattes = MatteTally()
        self.masks = MaskFolder(path / "masks")
        self.is_alpha = False
        self.pictures = PictureCheck()
        self.nbytes = 0
        self.fps: Fraction | None = None

    def report(self) -> Report:
        calibration = check_calibration(self.path)
        self.problems += [str(error) for error in calibration.errors]
        self.warnings += [f"{self.path}: {line}" for line in calibration.notes]
        calibrations = calibration.calibrations
        images_folder, masks_folder = self.path / "images", self._masks_folder()
        has_videos = not camera_folders(images_folder) and (self.path / VIDEOS).is_dir()
        names = self._camera_names(calibration, has_videos)
        images: Mapping[str, dict[str, str] | None] = {}
        if has_videos:
            frames = self._video_frames(names, calibrations)
        else:
            images = self._try(list_images, images_folder, names) or dict.fromkeys(names)
            self.fps = self._try(read_rate, self.path)
            frames = sort_frames(set().union(*(found for found in images.values() if found)))
            self.warnings += describe_gaps(images_folder, frames)
        self.is_alpha = bool(self._try(alpha_is_matte, self.path))
        masks = self._list_masks(masks_folder, names, frames)
        for name, found in images.items():
            self._check_folder(images_folder / name, found, frames)
        for name, found in masks.items():
            self._check_folder(masks_folder / name, found or None, frames)  # A camera needs no masks.
        files = [images_folder / name / file for name, found in images.items() for file in (found or {}).values()]
        files += [masks_folder / name / file for name, found in masks.items() for file in (found or {}).values()]
        sized = [
            file
            for file in self.track(files, len(files), "files")
            if self._check_header(file, calibrations.get(file.parent.name))
        ]
        sampled = _sample_files(images_folder, images) if self.is_alpha else _sample_files(masks_folder, masks)
        skipped = self._decode(sized, sampled)
        cameras = {name: self._to_camera(name, calibrations[name]) for name in names if name in calibrations}
        radius = self._check_poses({name: camera for name, camera in cameras.items() if camera is not None})
        self.warnings += self.mattes.warnings()
        notes = self._mask_notes(masks_folder)
        if self.mattes.is_empty and self.decode_seconds and not skipped:
            self.problems.append(
                f"{masks_folder}: expected mattes with the object in white, got only black ones; export the mattes "
                "again, or delete them and run fourd matte"
            )
        test_views = self._test_views(names)
        masked = tuple(name for name in self._try(masked_cameras, self.path) or () if name in names)
        return Report(
            tuple(self.problems),
            tuple(self.warnings),
            tuple(names),
            len(frames),
            self.fps,
            self.sizes,
            self.is_alpha or any(masks.values()),
            sum(_is_distorted(calibrations[name]) for name in names if name in calibrations),
            radius,
            self.mattes.mean,
            self.nbytes,
            skipped,
            tuple(notes),
            test_views,
            masked,
            calibration.metres_per_unit,
        )

    def _try(self, function: Callable[..., Value], *arguments: object) -> Value | None:
        """Call ``function`` and return its result; if it raises a UserError, record the error and return None."""
        try:
            return function(*arguments)
        except UserError as error:
            if str(error) not in self.problems:
                self.problems.append(str(error))
            return None

    def _test_views(self, names: Sequence[str]) -> tuple[str, ...] | None:
        """Return the test split of the capture, or None if it has none."""
        test_views = self._try(read_test_views, self.path)
        if test_views is not None:
            self._try(require_known, self.path, test_views, names)
        return test_views

    def _masks_folder(self) -> Path:
        """Return the folder of the user's mattes, or the folder of the generated mattes if the user has none."""
        has_own = bool(camera_folders(self.path / "masks")) or not (self.path / MATTES).is_dir()
        return self.path / ("masks" if has_own else MATTES)

    def _list_masks(
        self, folder: Path, names: Sequence[str], frames: Sequence[str]
    ) -> dict[str, dict[str, str] | None]:
        """List the mattes of each camera. Generated mattes of only some frames count as none, because fourd makes those
        that it needs."""
        masks = {name: self._try(list_masks, folder / name, frames) for name in names if not self.is_alpha}
        is_complete = all(set(frames) <= set(found or {}) for found in masks.values())
        return masks if folder != self.path / MATTES or is_complete else {}

    def _camera_names(self, calibration: CalibrationReport, has_videos: bool) -> list[str]:
        folder = VIDEOS if has_videos else "images"
        found = camera_folders(self.path / folder)
        if has_videos:
            found = list(self._try(find_videos, self.path / folder) or {})
        calibrated, found = calibration.names, [name for name in found if name not in calibration.incomplete]
        if not found:
            self.problems.append(
                f"{self.path / folder}: expected {'a video' if has_videos else 'a folder of images'} for each camera, "
                "got none; check the capture's path"
            )
        if len(found) == 1:
            self.problems.append(
                f"{self.path / folder}: expected at least {MIN_CAMERAS} cameras, got 1 ('{found[0]}'); add the "
                "recordings of the other cameras"
            )
        for name in found if calibrated else []:
            if name not in calibrated:
                self.problems.append(
                    f"{self.path / 'intri.yml'}: expected camera '{name}', since {folder}/{name} exists, got no such "
                    "name; calibrate the camera or exclude it with --views"
                )
        for name in calibrated:
            if name not in found:
                self.problems.append(
                    f"{self.path / folder / name}: expected images of camera '{name}', which is in intri.yml, got "
                    "none; restore them or exclude the camera with --views"
                )
        return [name for name in found if name in calibrated or not calibrated]

    def _video_frames(self, names: Sequence[str], calibrations: dict[str, Calibration]) -> list[str]:
        """Return the names of the frames that exist in all videos."""
        videos: dict[str, Video] = {}
        for name in names:
            videos |= self._try(list_videos, self.path, [name]) or {}
        for name, video in videos.items():
            size = (video.index.width, video.index.height)
            self.nbytes += video.path.stat().st_size
            self._check_size(video.path, name, calibrations.get(name), size, is_matte=False)
        self.fps = self._try(common_rate, videos)
        return [frame_name(number) for number in range(common_frames(videos))]

    def _check_folder(self, folder: Path, found: dict[str, str] | None, frames: list[str]) -> None:
        """Check that a camera's folder has all frames.

        ``found`` maps frame names to file names. It is None if the folder could not be listed, which has already been
        reported as an error.
        """
        if found is None:
            return
        if not found:
            self.problems.append(str(no_pictures_error(folder)))
            return
        error = missing_frame_error(folder, found, frames)
        if error is not None:
            self.problems.append(str(error))
        surplus = sort_frames(set(found) - set(frames))
        if surplus:
            self.warnings.append(
                f"{folder / found[surplus[0]]}: a matte without an image is not used ({len(surplus)} such files)"
            )

    def _check_header(self, file: Path, calibration: Calibration | None) -> bool:
        """Check the header of an image or matte. Returns whether it can be read."""
        header = self._try(read_header, file)
        if header is None:
            return False
        self.nbytes += file.stat().st_size
        if not self._is_matte(file):
            self._try(self.pictures.check, file, header, calibration)
        self._check_size(file, file.parent.name, calibration, header.size, self._is_matte(file))
        return True

    def _is_matte(self, file: Path) -> bool:
        return file.parent.parent.name != "images"

    def _decode(self, files: list[Path], sampled: set[Path]) -> Skipped | None:
        """Decode the mattes ``sampled``, and as many other files as the time allows. Returns what was skipped."""
        before, self.problems = self.problems, []
        for file in sorted(sampled & set(files)):
            self._decode_file(file)
        others = [file for file in files if file not in sampled]
        skipped = decode_pictures(others, self._decode_file, self.decode_seconds, self.track)
        self.problems = [*before, *sorted(self.problems)]
        return skipped

    def _decode_file(self, file: Path) -> None:
        if not self._is_matte(file):
            rgba = self._try(decode_picture, file)
            if rgba is not None and self.is_alpha and rgba.shape[2] == 4:
                self.mattes.add(file, rgba[..., 3])
            return
        is_generated = file.is_relative_to(self.path / MATTES)
        matte = self._try(decode_matte if is_generated else self.masks.decode, file)
        if matte is not None:
            self.mattes.add(file, matte)

    def _mask_notes(self, masks_folder: Path) -> list[str]:
        """Tell what the values of the user's masks mean, if they are not ordinary masks."""
        if self.is_alpha:
            return [f"{self.path / 'images'}: {ALPHA_NOTE}"]
        return self._try(self.masks.notes) or [] if masks_folder == self.masks.folder else []

    def _check_size(
        self, file: Path, name: str, calibration: Calibration | None, size: tuple[int, int], is_matte: bool
    ) -> None:
        if name not in self.sizes and not is_matte:
            self.sizes[name] = size
            if calibration is not None and calibration.width and calibration.height:
                self.sizes[name] = (calibration.width, calibration.height)
        expected = self.sizes.get(name, size)
        if size != expected:
            self.problems.append(
                f"{file}: expected {expected[0]} x {expected[1]} pixels like camera '{name}', "
                f"got {size[0]} x {size[1]}; export the file again at the expected size"
            )

    def _to_camera(self, name: str, calibration: Calibration) -> Camera | None:
        with suppress(ValueError):
            return calibration.camera(*self.sizes.get(name, (1, 1)))
        return None

    def _check_poses(self, cameras: dict[str, Camera]) -> float:
        """Warn of cameras at equal positions, and of cameras that face away from the common focus.

        Returns:
            The mean distance between the cameras and their common focus in world units; 0 if there is no common focus.
        """
        if len(cameras) < 2:
            return 0.0
        for line in describe_equal_positions(cameras):
            self.warnings.append(f"{self.path / 'extri.yml'}: {line}")
        inverted = describe_inverted(list(cameras.values()))
        if inverted is not None:
            # If the evidence is sure, reading the calibration has already failed.
            self.warnings += [] if inverted.is_sure else [f"{self.path / 'extri.yml'}: {inverted.reason}"]
            return 0.0
        focus = find_focus(list(cameras.values()))
        if focus is None:
            return 0.0
        for name, camera in cameras.items():
            to_focus = focus - camera.centre
            depth = float(to_focus @ camera.forward)
            miss = float(np.linalg.norm(to_focus - depth * camera.forward))
            if depth <= 0 or miss > MAX_FOCUS_MISS * depth:
                self.warnings.append(
                    f"{self.path / 'extri.yml'}: camera '{name}' faces away from the point that the other cameras face"
                )
        return float(np.mean([np.linalg.norm(focus - camera.centre) for camera in cameras.values()]))


def _sample_files(folder: Path, masks: Mapping[str, dict[str, str] | None]) -> set[Path]:
    """Choose a few evenly spaced files of each camera."""
    sampled = set()
    for name, found in masks.items():
        files = sort_names((found or {}).values())
        indices = np.linspace(0, len(files) - 1, min(SAMPLED_MATTES, len(files))).astype(int)
        sampled |= {folder / name / files[index] for index in indices}
    return sampled


def _is_distorted(calibration: Calibration) -> bool:
    return calibration.distortion is not None and bool(calibration.distortion.any())
