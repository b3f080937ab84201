"""The `.4dv` file: a ZIP64 of stored members, one a frame and attribute, and manifest.json.

Members are stored and never deflated, so that a web server's range requests and plain seeks get
at a frame's bytes. The reader takes the file for hostile: sizes are compared with the manifest
before anything is allocated.
"""

from __future__ import annotations

import errno
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.baking.manifest import ManifestError, NewerVersionError, manifest_from_json, manifest_to_json
from fourd.baking.scene import ATTRIBUTES, Attribute, BakedFrame, SceneManifest
from fourd.errors import UserError
from fourd.files import atomic_path

MANIFEST_NAME = "manifest.json"
MAX_MANIFEST_BYTES = 64 << 20
_STORED_AT = (1980, 1, 1, 0, 0, 0)
_ENCRYPTED = 0x1
_BROKEN = (
    zipfile.BadZipFile,
    zipfile.LargeZipFile,
    struct.error,
    zlib.error,
    EOFError,
    NotImplementedError,
    RuntimeError,
    ValueError,
    OverflowError,
)


def member_name(frame: int, attribute: str) -> str:
    """Path of a frame's array inside the ZIP."""
    return f"frames/{frame:06d}/{attribute}"


class SceneWriter:
    """Writes a scene frame by frame; memory does not grow with their number.

    Use as a context manager: the file appears at ``path`` whole when the block ends, and not at
    all (an older file stays) when it raises.

    Args:
        path: the `.4dv` to make; its folder is made when missing.
        manifest: of the scene; its ``points`` are filled in from the frames.

    Raises:
        UserError: when the disk is full or the place cannot be written.
        ValueError: when frames do not come in order, do not fit the manifest or hold numbers that
            are not finite.
    """

    def __init__(self, path: Path | str, manifest: SceneManifest) -> None:
        self.path = Path(path)
        self.manifest = manifest
        self._points: list[int] = []
        self._stack = ExitStack()
        self._zip: zipfile.ZipFile | None = None

    def __enter__(self) -> SceneWriter:
        with _disk_errors(self.path), ExitStack() as stack:
            temporary = stack.enter_context(atomic_path(self.path))
            self._zip = zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED, allowZip64=True)
            self._stack = stack.pop_all()
        return self

    def add_frame(self, index: int, frame: BakedFrame) -> None:
        """Append frame ``index``; frames come in order, from 0."""
        if index != len(self._points) or index >= self.manifest.frame_count:
            raise ValueError(f"index: expected frame {len(self._points)} of {self.manifest.frame_count}, got {index}")
        if frame.view_count != self.manifest.view_count:
            raise ValueError(f"frame: expected {self.manifest.view_count} source views, got {frame.view_count}")
        bad = frame.first_bad()
        if bad is not None:
            raise ValueError(
                f"frame {index}, {bad}: expected finite numbers (radius and weights >= 0, density in [0, 1])"
            )
        with _disk_errors(self.path):
            for attribute in ATTRIBUTES:
                array = getattr(frame, attribute.name).astype(attribute.dtype, copy=False)
                self._write(member_name(index, attribute.name), memoryview(array).cast("B") if array.size else b"")
        self._points.append(frame.point_count)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._zip is not None
        if error is not None:
            with suppress(OSError, ValueError):
                self._zip.close()
            self._stack.__exit__(kind, error, trace)
            return
        with _disk_errors(self.path), self._stack, self._zip:
            if len(self._points) != self.manifest.frame_count:
                raise ValueError(f"expected {self.manifest.frame_count} frames, got {len(self._points)}")
            self.manifest = replace(self.manifest, points=tuple(self._points))
            self._write(MANIFEST_NAME, manifest_to_json(self.manifest))

    def _write(self, name: str, content: bytes | memoryview) -> None:
        assert self._zip is not None
        info = zipfile.ZipInfo(name, _STORED_AT)
        info.external_attr = 0o644 << 16
        self._zip.writestr(info, content)


class SceneReader:
    """Reads a `.4dv`. Arrays are read when asked; nothing is kept.

    Raises:
        UserError: one line that names the file and the mend, on opening when the file is cut short,
            is no scene, is newer than this program or contradicts itself; on reading when a member
            is damaged.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self._zip = _opened(self.path)
        try:
            self._members = _checked_members(self.path, self._zip)
            self.manifest = self._read_manifest()
            self._check_frames()
        except BaseException:
            self._zip.close()
            raise

    def close(self) -> None:
        """Close the file; reading afterwards raises ValueError."""
        self._zip.close()

    def read(self, index: int) -> BakedFrame:
        """Frame ``index``, from 0. Raises IndexError outside the scene."""
        if not 0 <= index < self.manifest.frame_count:
            raise IndexError(f"frame: expected 0 to {self.manifest.frame_count - 1}, got {index}")
        frame = BakedFrame(*(self._array(index, attribute) for attribute in ATTRIBUTES))
        bad = frame.first_bad()
        if bad is not None:
            name = member_name(index, bad)
            raise _damaged(self.path, f"finite numbers in {name}", "NaN, infinity or a number out of range")
        return frame

    def _array(self, index: int, attribute: Attribute) -> NDArray[Any]:
        shape = attribute.sized(self.manifest.points[index], self.manifest.view_count)
        content = self._content(member_name(index, attribute.name))
        return np.frombuffer(content, dtype=attribute.dtype).reshape(shape)

    def _content(self, name: str) -> bytes:
        try:
            return self._zip.read(self._members[name])
        except _BROKEN as error:
            raise _damaged(self.path, f"a whole member {name}", str(error) or "the file's end") from error
        except OSError as error:
            raise UserError(f"{self.path}: cannot be read ({error}); check the disk") from error

    def _read_manifest(self) -> SceneManifest:
        if MANIFEST_NAME not in self._members:
            raise _damaged(self.path, f"a scene with {MANIFEST_NAME}", "a ZIP without it")
        size = self._members[MANIFEST_NAME].file_size
        if size > MAX_MANIFEST_BYTES:
            raise _damaged(self.path, f"at most {MAX_MANIFEST_BYTES} bytes of {MANIFEST_NAME}", f"{size}")
        try:
            return manifest_from_json(self._content(MANIFEST_NAME))
        except NewerVersionError as error:
            raise UserError(f"{self.path}: {error}; update fourd to open this newer scene") from error
        except ManifestError as error:
            raise UserError(f"{self.path}: {error}; export the scene again") from error

    def _check_frames(self) -> None:
        for index, points in enumerate(self.manifest.points):
            for attribute in ATTRIBUTES:
                name = member_name(index, attribute.name)
                expected = attribute.nbytes(points, self.manifest.view_count)
                if name not in self._members:
                    raise _damaged(self.path, f"a member {name}", "none")
                size = self._members[name].file_size
                if size != expected:
                    raise _damaged(self.path, f"{expected} bytes in {name} by the manifest", f"{size}")


def _opened(path: Path) -> zipfile.ZipFile:
    if path.is_dir():
        raise UserError(f"{path}: expected a .4dv file, got a folder; name the file that fourd export wrote")
    try:
        return zipfile.ZipFile(path)
    except FileNotFoundError as error:
        raise UserError(f"{path}: expected a .4dv file, got nothing there; check the name") from error
    except _BROKEN as error:
        raise UserError(
            f"{path}: expected a whole .4dv scene (a ZIP), got a file cut short or of another kind; "
            "copy or export it again"
        ) from error
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error}); check its permissions") from error


def _checked_members(path: Path, archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    members: dict[str, zipfile.ZipInfo] = {}
    size, total = path.stat().st_size, 0
    for info in archive.infolist():
        name = info.filename
        if name.startswith("/") or "\\" in name or ":" in name or ".." in name.split("/"):
            raise _damaged(path, "member names inside the archive", repr(name[:80]))
        if name in members:
            raise _damaged(path, "every member once", f"{name!r} twice")
        if info.flag_bits & _ENCRYPTED:
            raise UserError(f"{path}: expected plain members, got {name!r} encrypted; export the scene again")
        if info.compress_type != zipfile.ZIP_STORED or info.compress_size != info.file_size:
            raise UserError(
                f"{path}: expected stored members, got {name!r} compressed; zip it again with zip -0 or export again"
            )
        total += info.file_size
        members[name] = info
    if total > size:
        raise _damaged(path, f"members of at most {size} bytes, the file's size", f"{total}")
    return members


def _damaged(path: Path, expected: str, got: str) -> UserError:
    return UserError(f"{path}: expected {expected}, got {got}; the file is damaged: copy or export it again")


@contextmanager
def _disk_errors(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise UserError(f"{path}: the disk is full; free some space or write elsewhere with -o") from error
        raise UserError(f"{path}: cannot be written ({error.strerror or error}); write elsewhere with -o") from error
