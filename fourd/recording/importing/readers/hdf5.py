"""HDF5 files with encoded images and matrices, read in a child process.

The child process is needed because damaged files of this complex format have crashed the HDF5 library. Files that refer
to other files are refused.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from fourd.base.errors import UserError
from fourd.base.limits import require_regular
from fourd.base.processes.isolation import ParserProcess, Reply
from fourd.recording.capture.decoding import PICTURE_FORMATS
from fourd.recording.capture.layout import frame_name
from fourd.recording.importing.folders import parse_numbers
from fourd.recording.importing.imported import EncodedPictures

METHODS = ("has", "numbered", "picture_header", "content", "array")
"""Names of the methods of :class:`_OpenFile` that :func:`read_in_child` may call."""
MAX_SOFT_LINKS = 16
HEADER_BYTES = 1 << 16
"""Number of bytes at the start of an encoded image that always contain the image's width and height."""
MAX_IMAGE_BYTES = 256 << 20
"""Maximum size in bytes of an encoded image."""
MAX_NUMBERS = 1024
"""Maximum number of elements of a matrix."""
MAX_MEMBERS = 1_000_000
"""Maximum number of members of a group."""


class Hdf5File:
    """An HDF5 file that is read in a child process. The process starts when a method is called for the first time, and
    ends when this object is deleted.

    All methods raise UserError if the file is damaged or refers to other files. The message names file and group.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._parser = ParserProcess()

    def has(self, name: str) -> bool:
        """Return whether the file has an object with this path."""
        return bool(self._call("has", name).value)

    def numbered(self, name: str, required: bool = True) -> dict[int, str]:
        """Return the paths of the members of a group whose members have numbers as names. The paths are keyed by these
        numbers, in ascending order.

        If the group is missing and not ``required``, the result is empty.
        """
        numbers = self._call("numbered", name, required).value
        with self._checked(name):
            return {int(number): f"{name}/{member}" for number, member in numbers}

    def encoded(self, name: str) -> tuple[EncodedPictures, tuple[int, int]]:
        """Return a group's images ordered by number and named after it, and (width, height) of the first image."""
        numbered = self.numbered(name)
        paths, names = list(numbered.values()), tuple(frame_name(number) for number in numbered)
        if not paths:
            raise UserError(f"{self.path}: {name}: expected images, got none; download it again")
        found = self._call("picture_header", paths[0]).value
        with self._checked(name):
            width, height = int(found["width"]), int(found["height"])
            suffix = {"JPEG": ".jpg", "PNG": ".png"}[found["format"]]
        read = _Contents(self, tuple(paths))
        return EncodedPictures(len(paths), suffix, read, names), (width, height)

    def content(self, name: str) -> bytes:
        """Read the bytes of an encoded image."""
        return self._call("content", name).content

    def array(self, name: str, shape: tuple[int, ...]) -> np.ndarray:
        """Read a dataset of finite numbers with the shape ``shape``. If the shape is (-1,), the dataset is
        flattened."""
        reply = self._call("array", name)
        with self._checked(name):
            value = np.frombuffer(reply.content, np.float64).reshape([int(side) for side in reply.value])
        return parse_numbers(f"{self.path}: {name}", np.ravel(value) if shape == (-1,) else value, shape)

    def _call(self, method: str, name: str, *arguments: object) -> Reply:
        return self._parser.call(
            "fourd.recording.importing.readers.hdf5:read_in_child", self.path, method, name, *arguments
        )

    @contextmanager
    def _checked(self, name: str) -> Iterator[None]:
        """Raise UserError if the ``with`` block fails to convert a reply of the child process."""
        try:
            yield
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            message = f"{self.path}: {name}: expected intact HDF5, got other content; download it again"
            raise UserError(message) from error


@dataclass(frozen=True)
class _Contents:
    """Reads the encoded images at the paths ``paths`` of a file."""

    file: Hdf5File
    paths: tuple[str, ...]

    def __call__(self, index: int) -> bytes:
        return self.file.content(self.paths[index])


def read_in_child(path: str, method: str, name: str, *arguments: Any) -> Any:
    """Call a method of :class:`_OpenFile`, and return JSON values and bytes. :class:`Hdf5File` calls this function in
    its child process."""
    if method not in METHODS:
        raise ValueError(f"expected one of {METHODS}, got {method}")
    with _OpenFile(Path(path)) as file:
        return getattr(file, method)(name, *arguments)


class _OpenFile:
    """An open HDF5 file, in the child process."""

    def __init__(self, path: Path) -> None:
        import h5py  # h5py is imported here, because no other format needs it.

        self._path = path
        self._h5py = h5py
        try:
            require_regular(path)
            self._file = h5py.File(path, "r")
        except OSError as error:
            reason = str(error).partition("\n")[0]
            raise UserError(f"{path}: expected HDF5, got '{reason}'; download it again") from error

    def __enter__(self) -> _OpenFile:
        return self

    def __exit__(self, *exception: object) -> None:
        self._file.close()

    def has(self, name: str) -> bool:
        with self._report_errors(name):
            return self._resolve(name) is not None

    def numbered(self, name: str, required: bool) -> list[tuple[int, str]]:
        with self._report_errors(name):
            group = self._get(name)
            if group is None and not required:
                return []
            if not isinstance(group, self._h5py.Group):
                raise UserError(f"{self._path}: expected the group {name}, got none; download it again")
            if len(group) > MAX_MEMBERS:
                raise UserError(f"{self._path}: {name}: expected images, got {len(group)} members; download it again")
            members = [str(member) for member in group]
        wrong = [member for member in members if not (member.isdecimal() and len(member) < 10)]
        if wrong or len({int(member) for member in members}) < len(members):
            shown = ", ".join(wrong or members)[:200]
            raise UserError(f"{self._path}: {name}: expected numbers as names, got {shown}; download it again")
        return [(int(member), member) for member in sorted(members, key=int)]

    def picture_header(self, name: str) -> dict[str, Any]:
        head = self.content(name, HEADER_BYTES)[1]
        try:
            with Image.open(io.BytesIO(head), formats=PICTURE_FORMATS) as image:
                return {"width": image.width, "height": image.height, "format": image.format}
        except (OSError, ValueError, SyntaxError, KeyError, Image.DecompressionBombError) as error:
            raise UserError(
                f"{self._path}: {name}: expected a JPEG or PNG, got something else; download it again"
            ) from error

    def array(self, name: str) -> tuple[list[int], bytes]:
        with self._report_errors(name):
            dataset = self._dataset(name)
            if dataset.dtype.kind not in "fiu" or (dataset.size or 0) > MAX_NUMBERS:
                raise UserError(
                    f"{self._path}: {name}: expected a matrix of numbers, got {dataset.dtype} {dataset.shape}; "
                    "download it again"
                )
            value = np.asarray(dataset[()], np.float64)
        return list(value.shape), value.tobytes()

    def content(self, name: str, max_bytes: int | None = None) -> tuple[None, bytes]:
        """Read the bytes of an encoded image, or only its first ``max_bytes`` bytes."""
        with self._report_errors(name):
            dataset = self._dataset(name)
            if dataset.dtype != np.uint8 or dataset.ndim != 1:
                raise UserError(
                    f"{self._path}: {name}: expected the bytes of an image, got {dataset.dtype}; download it again"
                )
            if dataset.size > MAX_IMAGE_BYTES:
                raise UserError(
                    f"{self._path}: {name}: expected an image of at most {MAX_IMAGE_BYTES / 1e6:.0f} MB, got "
                    f"{dataset.size / 1e6:.0f} MB; download it again"
                )
            return None, bytes(dataset[:max_bytes].tobytes())

    def _dataset(self, name: str) -> Any:
        dataset = self._get(name)
        if not isinstance(dataset, self._h5py.Dataset):
            raise UserError(f"{self._path}: expected {name}, got none; download it again")
        if dataset.external:
            raise self._outside(name, "external storage")
        if dataset.is_virtual:
            raise self._outside(name, "a virtual dataset")
        return dataset

    def _get(self, name: str) -> Any:
        path = self._resolve(name)
        return None if path is None else self._file[path]

    def _resolve(self, name: str) -> str | None:
        """Resolve the soft links in the path of an object. Returns None if the object is missing.

        External links are rejected before the linked file is opened, because an import that followed them would copy
        the content of files outside the source.
        """
        path, parts, soft_links = "/", name.split("/"), 0
        while parts:
            part = parts.pop(0)
            if part in ("", "."):
                continue
            parent = self._file[path]
            link = parent.get(part, getlink=True) if isinstance(parent, self._h5py.Group) else None
            if link is None:
                return None
            if isinstance(link, self._h5py.ExternalLink):
                raise self._outside(name, f"a link to {link.filename}")
            if isinstance(link, self._h5py.SoftLink):
                soft_links += 1
                if soft_links > MAX_SOFT_LINKS:
                    return None
                path = "/" if link.path.startswith("/") else path
                parts = link.path.split("/") + parts
            else:
                path = f"{path.rstrip('/')}/{part}"
        return path

    def _outside(self, name: str, got: str) -> UserError:
        return UserError(f"{self._path}: {name}: expected data within this file, got {got}; download it again")

    @contextmanager
    def _report_errors(self, name: str) -> Iterator[None]:
        """Convert the exceptions that h5py raises for damaged files to UserErrors."""
        try:
            yield
        except (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError) as error:
            reason = str(error).partition("\n")[0]
            raise UserError(f"{self._path}: {name}: expected intact HDF5, got '{reason}'; download it again") from error
