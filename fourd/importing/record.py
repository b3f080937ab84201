""".fourd/import.json: what was imported into a folder and how, so that no other capture is overwritten."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from fourd.errors import UserError
from fourd.files import is_unused, write_text_atomically
from fourd.importing.formats.imported import EncodedPictures, Imported, PictureFiles

RECORD = Path(".fourd") / "import.json"
VERSION = 1


@dataclass(frozen=True)
class ImportRecord:
    """An import into a folder.

    Attributes:
        source: the source's path.
        format: name of its format.
        calibration, files: digests of what it held; see :func:`digests`.
        options: as the command had them.
        offsets: by which videos run late, as they were applied.
        unpacked: whether videos' frames were ever written as pictures there, of these files with these offsets.
        done: whether the import came to its end.
        warnings: what it warned of.
    """

    source: str
    format: str
    calibration: str
    files: str
    options: dict[str, Any]
    offsets: dict[str, int]
    unpacked: bool
    done: bool
    warnings: tuple[str, ...]


def read_record(out: Path) -> ImportRecord | None:
    """The record in the folder ``out``; None where that is new or holds no file.

    Raises:
        UserError: when ``out`` is a file, or holds something that no import wrote.
    """
    if is_unused(out):
        return None
    path = out / RECORD
    if not path.is_file():
        got = "one with other files" if out.is_dir() else "a file"
        raise UserError(f"{out}: expected a new folder, or one of an import, got {got}; name another")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content.pop("version") != VERSION:
            raise ValueError
        return ImportRecord(**content | {"warnings": tuple(content["warnings"])})
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise UserError(f"{path}: expected the record of an import, got something else; name another folder") from error


def check_same(out: Path, before: ImportRecord, source: Path, name: str) -> None:
    """Refuse a folder into which another source was imported. Raises UserError."""
    if (before.source, before.format) != (str(source.resolve()), name):
        raise UserError(
            f"{out}: expected a new folder or an import of {source} ({name}), got one of {before.source} "
            f"({before.format}); name another"
        )


def check_unpacked(out: Path, before: ImportRecord, files: str, offsets: Mapping[str, int]) -> None:
    """Refuse other videos or offsets than those of which frames were unpacked. Raises UserError."""
    if before.unpacked and before.files != files:
        raise UserError(
            f"{out}: expected the videos of which its frames were unpacked, got others; import into another folder"
        )
    if before.unpacked and before.offsets != dict(offsets):
        raise UserError(
            f"{out}: expected the offsets with which its frames were unpacked ({_said(before.offsets)}), got "
            f"{_said(offsets)}; import into another folder"
        )


def write_record(out: Path, record: ImportRecord) -> None:
    """Write it atomically."""
    write_text_atomically(out / RECORD, json.dumps({"version": VERSION} | asdict(record), indent=1) + "\n")


def digests(imported: Imported) -> tuple[str, str]:
    """Of the calibration that an importer read, and of names and sizes of its files: others mean another source."""
    lenses, files = hashlib.sha256(), hashlib.sha256()
    for camera in imported.cameras:
        lens = camera.lens
        if lens is not None:
            arrays = (lens.intrinsics, lens.rotation, lens.translation, lens.distortion)
            values = [None if array is None else array.tolist() for array in arrays]
            lenses.update(repr((camera.name, lens.width, lens.height, values)).encode())
        for frames in (camera.frames, camera.masks):
            if isinstance(frames, PictureFiles):
                what: object = [str(path) for path in frames.paths]
            elif isinstance(frames, EncodedPictures):
                what = (frames.count, frames.suffix)
            else:
                what = None if frames is None else (str(frames.path), frames.path.stat().st_size)
            files.update(repr((camera.name, what)).encode())
    return lenses.hexdigest(), files.hexdigest()


def _said(offsets: Mapping[str, int]) -> str:
    return ", ".join(f"{name}={frames}" for name, frames in offsets.items() if frames) or "none"
