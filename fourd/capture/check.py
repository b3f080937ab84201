"""What is wrong with a capture: all of it at once, where the reader stops at the first fault."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from fourd.cameras import Camera
from fourd.capture.calibration import Calibration, survey_calibration
from fourd.capture.decoding import decode_matte, decode_rgb, picture_size
from fourd.capture.focus import find_focus
from fourd.capture.layout import (
    MATTES,
    VIDEOS,
    camera_folders,
    find_pictures,
    find_videos,
    frame_name,
    frame_order,
    missing_frame,
)
from fourd.capture.video_list import Video, common_frames, list_videos
from fourd.errors import UserError

Value = TypeVar("Value")

LOOKED_AT = 5
"""Mattes of a camera whose content is looked at unless the check is deep."""
NO_OBJECT = 1e-4
ALL_OBJECT = 0.98
FAR_OFF = 0.5
"""A camera whose axis misses the common focus by more than this share of its distance looks elsewhere."""

Track = Callable[[Sequence[Path]], Iterable[Path]]


@dataclass(frozen=True)
class Report:
    """What a capture holds and what is wrong with it.

    Attributes:
        problems: faults that keep fourd from using the capture; a line each, with the mend.
        warnings: what is allowed and looks like a mistake.
        cameras: names of cameras with calibration and pictures.
        frames: number of frames.
        sizes: (width, height) in pixels by camera.
        has_masks: whether there are mattes.
        distorted: number of cameras with lens distortion.
        ring_radius: mean distance of the cameras from the point that they look at, world units; 0 if unknown.
        coverage: mean share of a picture that mattes hold, of those looked at; None without mattes.
        nbytes: size of all pictures, videos and mattes.
    """

    problems: tuple[str, ...]
    warnings: tuple[str, ...]
    cameras: tuple[str, ...]
    frames: int
    sizes: dict[str, tuple[int, int]]
    has_masks: bool
    distorted: int
    ring_radius: float
    coverage: float | None
    nbytes: int


def check_capture(path: Path | str, *, deep: bool = False, track: Track | None = None) -> Report:
    """Look at every file of a capture: names and sizes of all, contents of some or, when ``deep``, of all.

    ``track`` wraps the loop over files, for a progress bar. Never raises for what is wrong with the capture.
    """
    path = Path(path)
    if not path.is_dir():
        fault = (
            f"{path}: expected a capture's folder, got {'a file' if path.exists() else 'nothing there'}; check the path"
        )
        return Report((fault,), (), (), 0, {}, False, 0, 0.0, None, 0)
    return _Check(path, deep, track or (lambda files: files)).report()


class _Check:
    def __init__(self, path: Path, deep: bool, track: Track) -> None:
        self.path = path
        self.deep = deep
        self.track = track
        self.problems: list[str] = []
        self.warnings: list[str] = []
        self.sizes: dict[str, tuple[int, int]] = {}
        self.coverages: list[float] = []
        self.nbytes = 0

    def report(self) -> Report:
        survey = survey_calibration(self.path)
        self.problems += [str(fault) for fault in survey.faults]
        calibrations = survey.calibrations
        images_folder, masks_folder = self.path / "images", self._masks_folder()
        has_videos = not camera_folders(images_folder) and (self.path / VIDEOS).is_dir()
        names = self._names(survey.names, has_videos)
        images: dict[str, dict[str, str] | None] = {}
        if has_videos:
            stems = self._video_frames(names, calibrations)
        else:
            images = {name: self._try(find_pictures, images_folder / name) for name in names}
            stems = frame_order(set().union(*(found for found in images.values() if found)))
        masks = {name: self._try(find_pictures, masks_folder / name) for name in names}
        has_masks = any(masks.values())
        for name, found in images.items():
            self._files(images_folder / name, found, stems)
        for name, found in masks.items() if has_masks else ():
            self._files(masks_folder / name, found, stems)
        jobs = [images_folder / name / file for name, found in images.items() for file in (found or {}).values()]
        jobs += [masks_folder / name / file for name, found in masks.items() for file in (found or {}).values()]
        looked_at = self._sampled(masks_folder, masks)
        for file in self.track(jobs):
            self._picture(file, calibrations.get(file.parent.name), file in looked_at)
        cameras = {name: self._camera(name, calibrations[name]) for name in names if name in calibrations}
        radius = self._poses({name: camera for name, camera in cameras.items() if camera is not None})
        if names and not has_masks:
            self.warnings.append(f"{self.path / 'masks'}: no mattes; make them: fourd matte {self.path}")
        self._coverage_warning()
        return Report(
            tuple(self.problems),
            tuple(self.warnings),
            tuple(names),
            len(stems),
            self.sizes,
            has_masks,
            sum(_is_distorted(calibrations[name]) for name in names if name in calibrations),
            radius,
            float(np.mean(self.coverages)) if self.coverages else None,
            self.nbytes,
        )

    def _try(self, work: Callable[..., Value], *arguments: object) -> Value | None:
        try:
            return work(*arguments)
        except UserError as error:
            self.problems.append(str(error))
            return None

    def _masks_folder(self) -> Path:
        """Of the user's mattes where there are any, of those that fourd made otherwise."""
        has_own = bool(camera_folders(self.path / "masks")) or not (self.path / MATTES).is_dir()
        return self.path / ("masks" if has_own else MATTES)

    def _names(self, calibrated: Sequence[str], has_videos: bool) -> list[str]:
        place = VIDEOS if has_videos else "images"
        folders = camera_folders(self.path / place)
        if has_videos:
            folders = sorted(self._try(find_videos, self.path / place) or {})
        if not folders:
            self.problems.append(f"{self.path / place}: expected a folder of pictures for each camera, got none")
        for name in folders if calibrated else []:
            if name not in calibrated:
                self.problems.append(
                    f"{self.path / 'intri.yml'}: expected camera '{name}', since {place}/{name} exists, got no such "
                    "name; calibrate it or leave it out with --views"
                )
        for name in calibrated:
            if name not in folders:
                self.problems.append(
                    f"{self.path / place / name}: expected the pictures of camera '{name}' of intri.yml, got none "
                    "there; restore them or leave the camera out with --views"
                )
        return [name for name in folders if name in calibrated or not calibrated]

    def _video_frames(self, names: Sequence[str], calibrations: dict[str, Calibration]) -> list[str]:
        """Names of the frames that all videos have."""
        videos: dict[str, Video] = {}
        for name in names:
            videos |= self._try(list_videos, self.path, [name]) or {}
        for name, video in videos.items():
            size = (video.index.width, video.index.height)
            self.nbytes += video.path.stat().st_size
            self._size(video.path, name, calibrations.get(name), size, is_matte=False)
        return [frame_name(number) for number in range(common_frames(videos))]

    def _files(self, folder: Path, found: dict[str, str] | None, stems: list[str]) -> None:
        """The faults of a camera's folder; those of a folder that could not be listed are told already."""
        if found is None:
            return
        if not found:
            self.problems.append(f"{folder}: expected pictures (FRAME.jpg or .png), got none; restore them")
            return
        error = missing_frame(folder, found, stems)
        if error is not None:
            self.problems.append(str(error))
        surplus = sorted(set(found) - set(stems))
        if surplus:
            self.warnings.append(
                f"{folder / found[surplus[0]]}: no picture of that frame ({len(surplus)} such here); not used"
            )

    def _sampled(self, folder: Path, masks: dict[str, dict[str, str] | None]) -> set[Path]:
        """Mattes whose content is looked at: some of each camera, evenly spread."""
        chosen = set()
        for name, found in masks.items():
            files = sorted((found or {}).values())
            places = np.linspace(0, len(files) - 1, min(LOOKED_AT, len(files))).astype(int)
            chosen |= {folder / name / files[place] for place in places}
        return chosen

    def _picture(self, file: Path, calibration: Calibration | None, looked_at: bool) -> None:
        name, is_matte = file.parent.name, file.parent.parent.name != "images"
        size = self._try(picture_size, file)
        if size is None:
            return
        self.nbytes += file.stat().st_size
        self._size(file, name, calibration, size, is_matte)
        if is_matte and (looked_at or self.deep):
            matte = self._try(decode_matte, file)
            if matte is not None:
                self._matte(file, matte)
        elif self.deep:
            self._try(decode_rgb, file)

    def _size(
        self, file: Path, name: str, calibration: Calibration | None, size: tuple[int, int], is_matte: bool
    ) -> None:
        expected = self._expected_size(name, calibration, size, is_matte)
        if size != expected:
            self.problems.append(
                f"{file}: expected {expected[0]} x {expected[1]} pixels, as camera '{name}' has, "
                f"got {size[0]} x {size[1]}; export it again at that size"
            )

    def _expected_size(
        self, name: str, calibration: Calibration | None, size: tuple[int, int], is_matte: bool
    ) -> tuple[int, int]:
        if name not in self.sizes and not is_matte:
            self.sizes[name] = size
            if calibration is not None and calibration.width and calibration.height:
                self.sizes[name] = (calibration.width, calibration.height)
        return self.sizes.get(name, size)

    def _matte(self, file: Path, matte: np.ndarray) -> None:
        coverage = float(matte.mean()) / 255
        self.coverages.append(coverage)
        if 0 < matte.max() <= 1:
            self.problems.append(f"{file}: expected a matte from 0 to 255, got one from 0 to 1; multiply it by 255")
        elif coverage < NO_OBJECT:
            self.warnings.append(f"{file}: the matte is empty; the object should be white")
        elif coverage > ALL_OBJECT:
            self.warnings.append(f"{file}: the matte is all object; was it inverted?")

    def _coverage_warning(self) -> None:
        if self.coverages and ALL_OBJECT >= float(np.mean(self.coverages)) > 0.6:
            mean = float(np.mean(self.coverages))
            self.warnings.append(
                f"{self.path / 'masks'}: mattes hold {mean:.0%} of the pictures, the object is white; inverted?"
            )

    def _camera(self, name: str, calibration: Calibration) -> Camera | None:
        with suppress(ValueError):
            return calibration.camera(*self.sizes.get(name, (1, 1)))
        return None

    def _poses(self, cameras: dict[str, Camera]) -> float:
        """Warns of twins and of cameras that look away from the others' focus; the mean distance from it."""
        if len(cameras) < 2:
            return 0.0
        twins = Counter(tuple(np.round(camera.centre, 6)) for camera in cameras.values())
        for name, camera in cameras.items():
            if twins[tuple(np.round(camera.centre, 6))] > 1:
                self.warnings.append(f"{self.path / 'extri.yml'}: camera '{name}' stands where another one does")
        focus = find_focus(list(cameras.values()))
        if focus is None:
            return 0.0
        for name, camera in cameras.items():
            towards = focus - camera.centre
            along = float(towards @ camera.forward)
            aside = float(np.linalg.norm(towards - along * camera.forward))
            if along <= 0 or aside > FAR_OFF * along:
                self.warnings.append(
                    f"{self.path / 'extri.yml'}: camera '{name}' looks away from where the others look"
                )
        return float(np.mean([np.linalg.norm(focus - camera.centre) for camera in cameras.values()]))


def _is_distorted(calibration: Calibration) -> bool:
    return calibration.distortion is not None and bool(calibration.distortion.any())


def first_lines(lines: Sequence[str], most: int) -> Iterator[str]:
    """The first ``most`` lines, and how many more there are."""
    yield from lines[:most]
    if len(lines) > most:
        yield f"and {len(lines) - most} more"
