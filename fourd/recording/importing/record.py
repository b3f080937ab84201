"""The record .fourd/import.json of an import's source and options, which prevents an import from overwriting another
capture."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

from fourd.base.errors import UserError
from fourd.base.files import is_unused, resolved, write_text_atomically
from fourd.base.json_file import decode_json
from fourd.base.limits import read_json
from fourd.recording.capture.layout import DERIVED
from fourd.recording.capture.video_list import NAME as VIDEO_LIST
from fourd.recording.importing.imported import EncodedPictures, Imported, PictureFiles

RECORD = DERIVED / "import.json"
VERSION = 1
Number = Annotated[float, Meta(gt=-1e12, lt=1e12)]
"""A number in import.json. Valid offsets in frames and valid scales are far below the limit."""


@dataclass(frozen=True)
class ImportRecord:
    """The content of .fourd/import.json: the source, options and state of the import that writes the capture.

    Attributes:
        source: the source's path.
        format: name of the source's format.
        calibration: hash of the source's calibration; see :func:`digests`.
        files: hash of the names and sizes of the source's files; see :func:`digests`.
        options: options of the command.
        offsets: the applied time offsets of the videos, in frames of the capture.
        unpacked: whether the videos' frames were written as images; the images are aligned by ``offsets``.
        done: whether the import finished.
        warnings: warnings of the import.
        unsure: large time offsets that were found, but were not sure enough to be applied.
        sound: the user's choice of the sound.
    """

    source: str
    format: str
    calibration: str
    files: str
    options: dict[str, Any]
    offsets: dict[str, Number]
    unpacked: bool
    done: bool
    warnings: tuple[str, ...]
    unsure: dict[str, Number] = field(default_factory=dict)
    sound: str = "auto"


def read_record(out: Path) -> ImportRecord | None:
    """Read .fourd/import.json in the folder ``out``. Returns None if the folder is missing or empty.

    Raises:
        UserError: when ``out`` is a file, or contains files without a valid record.
    """
    if is_unused(out):
        return None
    path = out / RECORD
    if not path.is_file():
        got = "a folder with other files" if out.is_dir() else "a file"
        raise UserError(f"{out}: expected a new folder or the folder of an import, got {got}; name another folder")
    try:
        content = read_json(path)
        record = decode_json(content, ImportRecord)
        decode_json(record.options.get("reduce", 1), Number)
        if content["version"] != VERSION:
            raise ValueError(f"version: expected {VERSION}, got another version")
    except (ValueError, KeyError) as error:
        raise UserError(
            f"{path}: expected the record of an import, got other content ({error}); name another folder"
        ) from error
    return record


def describe_unsure(capture: Path) -> str:
    """Return a sentence with the offsets that the import of a capture found but did not apply, and with the option that
    applies them. It is empty if there are none, or if the folder is not from an import.

    A corrected capture has no record of its own. Its list of videos is a link to that of the imported capture.
    """
    record = _record_of(capture)
    if record is None or not record.unsure:
        return ""
    found = ", ".join(f"{name} {frames:+g}" for name, frames in record.unsure.items())
    option = ",".join(f"{name}={frames:g}" for name, frames in record.unsure.items())
    return (
        f"time offsets were found but not applied, because they are not sure ({found} frames); "
        f"to apply them, add --offset {option} to fourd make or fourd import"
    )


def sound_choice(capture: Path) -> str:
    """Return the choice of the sound with which a capture was imported, or "auto" if it is not from an import."""
    record = _record_of(capture)
    return "auto" if record is None else record.sound


def _record_of(capture: Path) -> ImportRecord | None:
    folder = (capture / VIDEO_LIST).resolve().parent
    return read_record(folder) if (folder / RECORD).is_file() else None


def check_same_source(out: Path, before: ImportRecord, source: Path, name: str) -> None:
    """Raise UserError when the folder contains an import of another source."""
    if (before.source, before.format) != (str(resolved(source)), name):
        raise UserError(
            f"{out}: expected a new folder or an import of {source} ({name}), got an import of {before.source} "
            f"({before.format}); name another folder"
        )


def check_unpacked(out: Path, before: ImportRecord, files: str, offsets: Mapping[str, float], reduce: float) -> None:
    """Raise UserError if an earlier import unpacked other videos into the folder, or the same videos with other offsets
    or at another scale."""
    if before.unpacked and before.files != files:
        raise UserError(
            f"{out}: expected the videos unpacked into this folder, got other videos; import into another folder"
        )
    if before.unpacked and before.options.get("reduce", 1) != reduce:
        raise UserError(
            f"{out}: expected the scale of the frames in this folder ({before.options.get('reduce', 1):g}), got "
            f"{reduce:g}; import into another folder"
        )
    if before.unpacked and before.offsets != dict(offsets):
        raise UserError(
            f"{out}: expected the offsets of the frames in this folder ({_format(before.offsets)}), got "
            f"{_format(offsets)}; import into another folder"
        )


def write_record(out: Path, record: ImportRecord) -> None:
    """Write the record of the folder ``out`` atomically."""
    write_text_atomically(out / RECORD, json.dumps({"version": VERSION} | asdict(record), indent=1) + "\n")


def digests(imported: Imported) -> tuple[str, str]:
    """Compute two hashes of a source: a hash of its calibration, and a hash of the names and sizes of its files."""
    calibrations, files = hashlib.sha256(), hashlib.sha256()
    if imported.metres_per_unit is not None:
        calibrations.update(repr(imported.metres_per_unit).encode())
    for camera in imported.cameras:
        calibration = camera.calibration
        if calibration is not None:
            arrays = (calibration.intrinsics, calibration.rotation, calibration.translation, calibration.distortion)
            values = [None if array is None else array.tolist() for array in arrays]
            calibrations.update(repr((camera.name, calibration.width, calibration.height, values)).encode())
        for frames in (camera.frames, camera.masks):
            if isinstance(frames, PictureFiles):
                content: object = [(str(path), name) for path, name in zip(frames.paths, frames.names, strict=True)]
            elif isinstance(frames, EncodedPictures):
                content = (frames.names, frames.suffix)
            else:
                content = None if frames is None else (str(frames.path), frames.path.stat().st_size)
            files.update(repr((camera.name, content)).encode())
    return calibrations.hexdigest(), files.hexdigest()


def _format(offsets: Mapping[str, float]) -> str:
    return ", ".join(f"{name}={frames:g}" for name, frames in offsets.items() if frames) or "none"
