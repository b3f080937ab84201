"""Protects the files of the user from commands: an output must not replace an input, nor the files of a capture or of a
run.

Each command marks its arguments that are paths with READS or with a :class:`Writes`, so that the check is the same in
all commands.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from fourd.base.errors import UserError
from fourd.base.files import resolved
from fourd.base.storage import Location, StorageUrl
from fourd.reconstruction.training.run_layout import CHECKPOINTS, CONFIG_NAME, LIVE, PREPARATION, SEGMENTS, VALIDATION
from fourd.recording.capture.layout import EXTRINSICS_NAME, INTRINSICS_NAME, VIDEOS

CAPTURE_FILES = (INTRINSICS_NAME, EXTRINSICS_NAME, "images", "masks", VIDEOS, "bgs", "videos.json", "split.json")
RUN_FILES = (CONFIG_NAME, CHECKPOINTS, SEGMENTS, VALIDATION, LIVE, "metrics.jsonl", *PREPARATION)


@dataclass(frozen=True)
class Reads:
    """Marks an argument that names a file or folder that the command reads."""


@dataclass(frozen=True)
class Writes:
    """Marks an argument that names a file or folder that the command writes.

    Attributes:
        is_replaced: whether the command replaces a whole folder, so that no input may be inside it.
        suffixes: suffixes of the files that may be replaced. If there are none, the command itself checks the suffix,
            or writes a folder.
    """

    is_replaced: bool = False
    suffixes: tuple[str, ...] = ()


READS = Reads()
WRITES = Writes()
WRITES_WHOLE_FOLDER = Writes(is_replaced=True)
WRITES_JSON = Writes(suffixes=(".json",))

Mark = Reads | Writes


def refuse_overwriting(arguments: object) -> None:
    """Raise UserError if an output in the parsed arguments of a command is an input, another output, or a file that
    belongs to a capture or a run."""
    marked = list(marked_paths(arguments))
    inputs = [path for path, mark in marked if isinstance(mark, Reads)]
    outputs = [(path, mark) for path, mark in marked if isinstance(mark, Writes)]
    for index, (path, mark) in enumerate(outputs):
        require_distinct(path, inputs, is_replaced=mark.is_replaced)
        for other, _ in outputs[:index]:
            if _is_same(path, other):
                raise UserError(f"{path}: expected another name for each output, got the same name twice; change one")
        if isinstance(path, Path):
            _refuse_foreign_file(path, mark)


def require_distinct(output: Location, inputs: Sequence[Location], *, is_replaced: bool = False) -> None:
    """Raise UserError if ``output`` is one of the inputs, also under another name or through a link, or if it belongs
    to a capture or a run.

    Args:
        output: the file or folder to be written.
        inputs: the files and folders to be read.
        is_replaced: whether the whole folder ``output`` is replaced, so that no input may be inside it.
    """
    for path in inputs:
        if _is_same(output, path):
            how = "" if str(output) == str(path) else f", which is the same as {path}"
            raise UserError(
                f"{output}: expected an output that is not an input, got an input{how}; name another output"
            )
        if is_replaced and _is_inside(path, output):
            raise UserError(
                f"{output}: expected a folder without inputs, because it is replaced, got the folder of {path}; name "
                "another output"
            )
    if isinstance(output, Path):
        _refuse_protected(output)


def marked_paths(arguments: object) -> Iterator[tuple[Location, Mark]]:
    """Yield each path and URL in the arguments of a command, with the mark of its field. Nested dataclasses are
    included."""
    for name, hint, value in _fields(arguments):
        if is_dataclass(value) and not isinstance(value, StorageUrl):
            yield from marked_paths(value)
            continue
        values = value if isinstance(value, tuple) else (value,)
        for path in values:
            if isinstance(path, Path | StorageUrl):
                mark = find_mark(hint)
                assert mark is not None, f"{type(arguments).__module__}: {name} is neither read nor written"
                yield path, mark


def find_mark(hint: Any) -> Mark | None:
    """Return the mark in a type annotation, or None."""
    if get_origin(hint) is Annotated:
        inner, *metadata = get_args(hint)
        marks = [each for each in metadata if isinstance(each, Reads | Writes)]
        return marks[0] if marks else find_mark(inner)
    found = [mark for each in get_args(hint) if (mark := find_mark(each)) is not None]
    return found[0] if found else None


def _fields(arguments: object) -> Iterator[tuple[str, Any, Any]]:
    """Yield name, annotation and value of each field of a dataclass."""
    assert is_dataclass(arguments)
    assert not isinstance(arguments, type)
    hints = get_type_hints(type(arguments), include_extras=True)
    for field in fields(arguments):
        yield field.name, hints[field.name], getattr(arguments, field.name)


def _is_same(first: Location, second: Location) -> bool:
    """Return whether two locations are the same file or folder, also through links and other spellings of its name."""
    if not (isinstance(first, Path) and isinstance(second, Path)):
        return str(first).rstrip("/") == str(second).rstrip("/")
    if resolved(first) == resolved(second):
        return True
    try:
        return os.path.samefile(first, second)
    except (OSError, ValueError):
        return False


def _is_inside(path: Location, folder: Location) -> bool:
    return isinstance(path, Path) and isinstance(folder, Path) and resolved(path).is_relative_to(resolved(folder))


def _refuse_protected(output: Path) -> None:
    """Raise UserError if an output lies in the files of the innermost capture or run that contains it."""
    place = resolved(output.parent) / output.name
    for folder in (place, *place.parents):
        names = _own_files(folder)
        if names and folder != place:
            name = place.relative_to(folder).parts[0]
            if name in names:
                kind = "run" if names == RUN_FILES else "capture"
                raise UserError(
                    f"{output}: expected an output outside the files of a {kind}, got a path in {folder / name}; name "
                    "another output"
                )
        if names:
            return


def _own_files(folder: Path) -> tuple[str, ...]:
    """Return the names of the files and folders that belong to a capture or a run, or nothing for other folders."""
    if (folder / CONFIG_NAME).is_file() and any((folder / name).is_dir() for name in (*PREPARATION, CHECKPOINTS)):
        return RUN_FILES
    if any((folder / name).is_file() for name in (INTRINSICS_NAME, EXTRINSICS_NAME)):
        return CAPTURE_FILES
    return ()


def _refuse_foreign_file(output: Path, mark: Writes) -> None:
    """Raise UserError if an output would replace a file of another kind."""
    if mark.suffixes and output.is_file() and output.suffix.lower() not in mark.suffixes:
        listed = " or ".join(mark.suffixes)
        raise UserError(f"{output}: expected a new file or a {listed} file, got another file; name another output")
