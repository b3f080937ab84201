"""Search for a calibration and its frames if the two are in different folders.

Motion capture programs keep the calibration of a session in a folder beside the recordings, for example
SESSION/calibration/NAME.qca.txt beside SESSION/TRIAL/videos/. The search covers two levels of folders below the source,
and calibration folders beside the source and beside its parent folder.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from fourd.base.errors import UserError, command_line
from fourd.base.files import list_folder
from fourd.recording.capture.layout import EXTRINSICS_NAME, INTRINSICS_NAME
from fourd.recording.importing.folders import CALIBRATION_FOLDER, find_frames
from fourd.recording.importing.imported import Imported

MAX_DEPTH = 2
"""The search covers this number of folder levels below the source, and this number of parent folders above it."""
CALIBRATION_NAME = re.compile(r"calib|camera|intri|extri|\.qca", re.IGNORECASE)
CALIBRATION_SUFFIXES = (
    *(".toml", ".yml", ".yaml", ".json", ".xml", ".txt", ".csv", ".xcp", ".calib"),
    *(".pickle", ".pkl", ".npz", ".npy", ".mat"),
)
PICKLES = (".pickle", ".pkl", ".npy")
FRAME_STORES = ("images", "masks", "mask", "rgbs")
"""Folders with images and mattes, which are not searched, because they contain many files and no calibration."""
MAX_LISTED = 8


@dataclass(frozen=True)
class CalibrationFormat:
    """A format whose calibration is one file.

    Attributes:
        name: the format's name on the command line.
        is_calibration: function that tests whether a file is a calibration of this format.
        read: function that takes a calibration file and the folder of the frames, and reads the cameras.
        names: function that reads the names of the cameras of a calibration file. It raises UserError for an invalid
            file.
    """

    name: str
    is_calibration: Callable[[Path], bool]
    read: Callable[[Path, Path], Imported]
    names: Callable[[Path], Collection[str]]


@dataclass(frozen=True)
class Layout:
    """A calibration and the frames that it belongs to.

    Attributes:
        format: format of the calibration.
        calibration: the calibration file.
        frames: folder in which :func:`~fourd.recording.importing.folders.find_frames` finds the frames.
        refused: one line for each file that looks like a calibration but is not used, with the reason.
    """

    format: CalibrationFormat
    calibration: Path
    frames: Path
    refused: tuple[str, ...]

    def read(self, source: Path) -> Imported:
        """Read the cameras. The notes of the result list the calibration file, the folder of the frames if it is not
        ``source``, and the calibration files that are not used."""
        imported = self.format.read(self.calibration, self.frames)
        notes = [f"calibration: {self.calibration}"]
        notes += [f"frames: {self.frames}"] if self.frames != source else []
        return Imported(imported.cameras, (*notes, *imported.notes, *_listed(self.refused)))


@dataclass(frozen=True)
class Frames:
    """Frames for which no usable calibration was found. :class:`Layout` describes the attributes."""

    folder: Path
    refused: tuple[str, ...]

    def notes(self, source: Path) -> tuple[str, ...]:
        """Return notes that name the folder of the frames, and the calibration files that are not used."""
        return (*([f"frames: {self.folder}"] if self.folder != source else []), *_listed(self.refused))


def find_layout(source: Path, formats: Sequence[CalibrationFormat]) -> Layout | Frames | None:
    """Find the frames of ``source`` and their calibration.

    ``source`` is a folder, or a calibration file. Calibrations inside ``source`` are preferred to calibrations in its
    parent folders. If calibrations of several formats are at the same level, the format that comes first in ``formats``
    is used.

    Returns:
        The layout if frames and a calibration are found, the frames if no calibration is found, or None if no frames
        are found.

    Raises:
        UserError: if ``source`` contains several recordings, if it contains an OpenCap session, if all calibrations
            inside ``source`` are unusable, or if two calibrations of the same format are usable.
    """
    folder = source if source.is_dir() else source.parent
    _refuse_opencap(folder)
    inside = [source] if folder != source else list(_files_below(folder, MAX_DEPTH))
    beside = [path for above in _parents(folder) for path in _files_beside(above)]
    names = _calibrated_names([*inside, *beside], formats)
    frames = _find_recording(folder, names)
    if frames is None and folder != source:
        frames = _find_recording(folder.parent, names)
    if frames is None:
        return None
    refused: list[str] = []
    layout = _choose(inside, frames, formats, refused)
    if layout is None and any(_recognise(path, formats) for path in inside):
        raise UserError(
            f"{source}: expected a calibration of the cameras in {frames}, got none that fits: {'; '.join(refused)}; "
            f"correct it, or calibrate from the images with {command_line('fourd', 'import', 'videos', source, 'OUT')}"
        )
    for above in _parents(folder) if layout is None else ():
        layout = _choose(list(_files_beside(above)), frames, formats, refused)
        if layout is not None:
            break
    return layout or Frames(frames, tuple(refused))


def calibration_outside(source: Path, formats: Sequence[CalibrationFormat]) -> Path | None:
    """Return the path of the calibration that :func:`find_layout` finds outside ``source``, or None."""
    try:
        found = find_layout(source, formats)
    except UserError:
        return None
    if not isinstance(found, Layout) or found.calibration.is_relative_to(source):
        return None
    return found.calibration


def describe_refused(source: Path, formats: Sequence[CalibrationFormat]) -> str:
    """Return one line that lists the files in ``source`` that look like calibrations; empty if there are none."""
    if not source.is_dir():
        return ""
    paths = [path for path in _files_below(source, MAX_DEPTH) if _is_suspect(path)]
    lines = [f"{path} ({_reason(path)})" for path in paths if not _recognise(path, formats)]
    return "; ".join(_listed(tuple(lines)))


def _choose(
    paths: Sequence[Path], frames: Path, formats: Sequence[CalibrationFormat], refused: list[str]
) -> Layout | None:
    """Choose one of the calibrations ``paths``. For each file that is not used, append a line with the reason to
    ``refused``."""
    usable: list[tuple[CalibrationFormat, Path]] = []
    for path in paths:
        form = _recognise(path, formats)
        if form is None:
            if _is_suspect(path):
                refused.append(f"{path} ({_reason(path)})")
            continue
        try:
            form.read(path, frames)
        except UserError as error:
            refused.append(f"{path} ({str(error).removeprefix(f'{path}: ').replace('; ', ', ')})")
        else:
            usable.append((form, path))
    if not usable:
        return None
    form, path = min(usable, key=lambda item: formats.index(item[0]))
    same = [other for other_form, other in usable if other_form == form]
    if len(same) > 1:
        raise UserError(
            f"{path.parent}: expected one calibration, got {' and '.join(str(other) for other in same)}; name the file "
            "to use as the source, or move the other away"
        )
    refused += [f"{other} (a second calibration; {path.name} is used)" for _, other in usable if other != path]
    return Layout(form, path, frames, tuple(refused))


def _calibrated_names(paths: Sequence[Path], formats: Sequence[CalibrationFormat]) -> set[str]:
    """Return the names of the cameras of all calibrations among ``paths``."""
    names: set[str] = set()
    for path in paths:
        form = _recognise(path, formats)
        if form is not None:
            with suppress(UserError):
                names |= set(form.names(path))
    return names


def find_calibration(source: Path, formats: Sequence[CalibrationFormat]) -> tuple[CalibrationFormat, Path] | None:
    """Return the first calibration in ``source``, or None if there is none."""
    paths = _files_below(source, MAX_DEPTH) if source.is_dir() else iter([source])
    found = ((_recognise(path, formats), path) for path in paths)
    return next(((form, path) for form, path in found if form is not None), None)


def _find_recording(source: Path, names: Collection[str]) -> Path | None:
    """Return the folder below ``source`` that contains frames. Calibration folders are skipped. ``names`` are the names
    of the calibrated cameras."""
    folders = [source]
    for _ in range(MAX_DEPTH + 1):
        found = [folder for folder in folders if _has_frames(folder, names)]
        if len(found) > 1:
            raise UserError(
                f"{source}: expected one recording, got {len(found)}: {', '.join(map(str, found[:MAX_LISTED]))}; name "
                "one of them"
            )
        if found:
            return found[0]
        folders = [
            child for folder in folders for child in _children(folder) if not CALIBRATION_FOLDER.search(child.name)
        ]
    return None


def _has_frames(folder: Path, names: Collection[str]) -> bool:
    try:
        return bool(find_frames(folder, names=names))
    except (UserError, OSError):
        return False


def _files_below(folder: Path, depth: int) -> Iterator[Path]:
    """Yield the files in ``folder`` and its subfolders, level by level."""
    folders = [folder]
    for _ in range(depth + 1):
        for each in folders:
            yield from _files(each)
        folders = [child for each in folders for child in _children(each) if child.name not in FRAME_STORES]


def _files_beside(folder: Path) -> Iterator[Path]:
    """Yield the files in ``folder`` and in its calibration folders."""
    yield from _files(folder)
    for child in _children(folder):
        # Other subfolders of ``folder`` are not searched, because they may contain other recordings.
        if CALIBRATION_FOLDER.match(child.name):
            yield from _files_below(child, 1)


def _parents(folder: Path) -> list[Path]:
    return list(Path(os.path.abspath(folder)).parents)[:MAX_DEPTH]


def _children(folder: Path) -> list[Path]:
    return [entry for entry in _entries(folder) if entry.is_dir()]


def _files(folder: Path) -> list[Path]:
    return [entry for entry in _entries(folder) if entry.suffix.lower() in CALIBRATION_SUFFIXES and entry.is_file()]


def _entries(folder: Path) -> list[Path]:
    try:
        return [folder / name for name in list_folder(folder)]
    except OSError:
        return []


def _recognise(path: Path, formats: Sequence[CalibrationFormat]) -> CalibrationFormat | None:
    return next((form for form in formats if form.is_calibration(path)), None)


def _is_suspect(path: Path) -> bool:
    if path.name == EXTRINSICS_NAME:
        # An extri.yml beside an intri.yml is not listed, because the message about intri.yml also mentions extri.yml.
        return not (path.parent / INTRINSICS_NAME).is_file()
    return CALIBRATION_NAME.search(path.name) is not None


def _reason(path: Path) -> str:
    """Explain why a file that no format recognises is not used."""
    if path.suffix.lower() in PICKLES:
        return "fourd never loads pickles, because loading one can run code"
    for own, other in ((INTRINSICS_NAME, EXTRINSICS_NAME), (EXTRINSICS_NAME, INTRINSICS_NAME)):
        if path.name == own:
            return f"no {other} beside it"
    if path.suffix.lower() == ".toml":
        return "no table of a camera with matrix, rotation and translation"
    return "not a format that fourd reads"


def _refuse_opencap(folder: Path) -> None:
    """Raise UserError for a session of OpenCap, whose calibration is in pickles."""
    for root in (folder, folder / "Videos"):
        for child in _children(root):
            path = child / "cameraIntrinsicsExtrinsics.pickle"
            if child.name.startswith("Cam") and path.is_file():
                raise UserError(
                    f"{path}: expected a calibration as text, got OpenCap's pickle, which fourd never loads, because "
                    "loading a pickle can run code; convert the session with the program in docs/importing.md (OpenCap)"
                )


def _listed(lines: tuple[str, ...]) -> list[str]:
    shown = [f"not a usable calibration: {line}" for line in lines[:MAX_LISTED]]
    return shown + ([f"and {len(lines) - MAX_LISTED} more such files"] if len(lines) > MAX_LISTED else [])
