"""The `.4dv` file: a ZIP64 of stored members, one a frame and attribute, and manifest.json.

A full scene has its background's attributes once, and may have one more member a frame: the shadow on it.

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
from threading import Lock
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.baking.combine import joined
from fourd.baking.manifest import ManifestError, NewerVersionError, manifest_from_json, manifest_to_json
from fourd.baking.scene import (
    ATTRIBUTES,
    FULL_VERSION,
    OBJECT_VERSION,
    BakedFrame,
    SceneBackground,
    SceneManifest,
)
from fourd.errors import UserError
from fourd.files import atomic_path

MANIFEST_NAME = "manifest.json"
MAX_MANIFEST_BYTES = 64 << 20
BACKGROUND = "background"
"""Folder of the background's members."""
SHADOW = "shadow"
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
    return f"{_frame_folder(frame)}/{attribute}"


class SceneWriter:
    """Writes a scene frame by frame; memory does not grow with their number.

    Use as a context manager: the file appears at ``path`` whole when the block ends, and not at
    all (an older file stays) when it raises.

    Args:
        path: the `.4dv` to make; its folder is made when missing.
        manifest: of the scene; ``points``, ``background`` and ``version`` are filled in from what is added.

    Raises:
        UserError: when the disk is full or the place cannot be written.
        ValueError: when frames do not come in order, do not fit the manifest or each other or hold numbers
            that are not finite, and when a full scene's background does not come exactly once.
    """

    def __init__(self, path: Path | str, manifest: SceneManifest) -> None:
        self.path = Path(path)
        self.manifest = manifest
        self._points: list[int] = []
        self._background: int | None = None  # number of points, once it was added
        self._shadow: int | None = None  # length of the frames' shadows; None while there are none
        self._stack = ExitStack()
        self._zip: zipfile.ZipFile | None = None

    def __enter__(self) -> SceneWriter:
        with _disk_errors(self.path), ExitStack() as stack:
            temporary = stack.enter_context(atomic_path(self.path))
            self._zip = zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED, allowZip64=True)
            self._stack = stack.pop_all()
        return self

    def add_frame(self, index: int, frame: BakedFrame, shadow: NDArray[np.uint8] | None = None) -> None:
        """Append frame ``index``; frames come in order, from 0.

        Args:
            frame: the points of this frame alone.
            shadow: (M,) uint8, the factors in 1/128 by which the colours of a full scene's M background
                points are multiplied in this frame. Given for all frames or for none.
        """
        if index != len(self._points) or index >= self.manifest.frame_count:
            raise ValueError(f"index: expected frame {len(self._points)} of {self.manifest.frame_count}, got {index}")
        self._check(f"frame {index}", frame)
        if shadow is not None or self._shadow is not None:
            self._check_shadow(index, shadow)
        self._write_arrays(_frame_folder(index), frame)
        if shadow is not None:
            self._write_array(member_name(index, SHADOW), shadow)
            self._shadow = len(shadow)
        self._points.append(frame.point_count)

    def add_background(self, frame: BakedFrame) -> None:
        """Add the static points of a full scene, once; before, between or after the frames."""
        if self.manifest.kind != "full":
            raise ValueError(f'background: expected none in a scene of kind "{self.manifest.kind}", got one')
        if self._background is not None:
            raise ValueError("background: expected one, got a second")
        self._check("background", frame)
        if self._shadow not in (None, frame.point_count):
            raise ValueError(
                f"background: expected {self._shadow} points, as the frames' shadows have, got {frame.point_count}"
            )
        self._write_arrays(BACKGROUND, frame)
        self._background = frame.point_count

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
            self.manifest = self._finished_manifest()
            self._write(MANIFEST_NAME, manifest_to_json(self.manifest))

    def _finished_manifest(self) -> SceneManifest:
        if len(self._points) != self.manifest.frame_count:
            raise ValueError(f"expected {self.manifest.frame_count} frames, got {len(self._points)}")
        points = tuple(self._points)
        if self.manifest.kind == "object":
            return replace(self.manifest, points=points, version=OBJECT_VERSION)
        if self._background is None:
            raise ValueError('background: expected one in a scene of kind "full", got none; call add_background')
        background = SceneBackground(self._background, shadow=self._shadow is not None)
        return replace(self.manifest, points=points, background=background, version=FULL_VERSION)

    def _check(self, what: str, frame: BakedFrame) -> None:
        if frame.view_count != self.manifest.view_count:
            raise ValueError(f"{what}: expected {self.manifest.view_count} source views, got {frame.view_count}")
        bad = frame.find_invalid_array()
        if bad is not None:
            raise ValueError(f"{what}, {bad}: expected finite numbers (radius and weights >= 0, density in [0, 1])")

    def _check_shadow(self, index: int, shadow: NDArray[np.uint8] | None) -> None:
        where = f"frame {index}, shadow"
        if self.manifest.kind != "full":
            raise ValueError(f'{where}: expected none in a scene of kind "{self.manifest.kind}", got one')
        if shadow is None:
            raise ValueError(f"{where}: expected one, as in the frames before, got none")
        if self._shadow is None and index > 0:
            raise ValueError(f"{where}: expected none, as in the frames before, got one")
        length = self._shadow if self._background is None else self._background
        if shadow.dtype != np.uint8 or shadow.ndim != 1 or length not in (None, len(shadow)):
            points = "M" if length is None else length
            raise ValueError(f"{where}: expected uint8 of shape ({points},), got {shadow.dtype} of {shadow.shape}")

    def _write_arrays(self, folder: str, frame: BakedFrame) -> None:
        for attribute in ATTRIBUTES:
            array = getattr(frame, attribute.name).astype(attribute.dtype, copy=False)
            self._write_array(f"{folder}/{attribute.name}", array)

    def _write_array(self, name: str, array: NDArray[Any]) -> None:
        with _disk_errors(self.path):
            self._write(name, np.ascontiguousarray(array).data.cast("B") if array.size else b"")

    def _write(self, name: str, content: bytes | memoryview) -> None:
        assert self._zip is not None
        info = zipfile.ZipInfo(name, _STORED_AT)
        info.external_attr = 0o644 << 16
        self._zip.writestr(info, content)


class SceneReader:
    """Reads a `.4dv`. Arrays are read when asked; the background alone is kept. Threads may share it.

    Raises:
        UserError: one line that names the file and the mend, on opening when the file is cut short,
            is no scene, is newer than this program or contradicts itself; on reading when a member
            is damaged.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self._zip = _opened(self.path)
        self._background: BakedFrame | None = None
        self._lock = Lock()
        try:
            self._members = _checked_members(self.path, self._zip)
            self.manifest = self._read_manifest()
            self._check_sizes()
        except BaseException:
            self._zip.close()
            raise

    def close(self) -> None:
        """Close the file and let go of the background; reading afterwards raises ValueError."""
        self._zip.close()
        self._background = None

    def read(self, index: int) -> BakedFrame:
        """Frame ``index``, from 0: its own points, then the background's in the frame's shadow, if there are any.

        Its arrays are read-only. Raises IndexError outside the scene.
        """
        moving = self.read_dynamic(index)
        background = self.read_background()
        return moving if background is None else joined(moving, background, self.read_shadow(index))

    def read_dynamic(self, index: int) -> BakedFrame:
        """The points that frame ``index`` alone has. Raises IndexError outside the scene."""
        self._require_frame(index)
        return self._read(_frame_folder(index), self.manifest.points[index])

    def read_background(self) -> BakedFrame | None:
        """The points that all frames share, without shadows; None in an object scene. Read once, and kept."""
        described = self.manifest.background
        if described is None:
            return None
        with self._lock:
            if self._background is None:
                self._background = self._read(BACKGROUND, described.points)
            return self._background

    def read_shadow(self, index: int) -> NDArray[np.uint8] | None:
        """(M,) factors in 1/128 for the M background points' colours in a frame; None where there are none.

        Raises IndexError outside the scene.
        """
        self._require_frame(index)
        if self.manifest.background is None or not self.manifest.background.shadow:
            return None
        return np.frombuffer(self._content(member_name(index, SHADOW)), np.uint8)

    def _require_frame(self, index: int) -> None:
        if not 0 <= index < self.manifest.frame_count:
            raise IndexError(f"frame: expected 0 to {self.manifest.frame_count - 1}, got {index}")

    def _read(self, folder: str, points: int) -> BakedFrame:
        arrays: list[NDArray[Any]] = []
        for attribute in ATTRIBUTES:
            content = self._content(f"{folder}/{attribute.name}")
            shape = attribute.sized(points, self.manifest.view_count)
            arrays.append(np.frombuffer(content, dtype=attribute.dtype).reshape(shape))
        frame = BakedFrame(*arrays)
        bad = frame.find_invalid_array()
        if bad is not None:
            name = f"{folder}/{bad}"
            raise _damaged(self.path, f"finite numbers in {name}", "NaN, infinity or a number out of range")
        return frame

    def _content(self, name: str) -> bytes:
        if self._zip.fp is None:
            raise ValueError(f"{self.path}: expected an open scene, got one that was closed")
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

    def _check_sizes(self) -> None:
        for name, expected in _sizes(self.manifest):
            if name not in self._members:
                raise _damaged(self.path, f"a member {name}", "none")
            size = self._members[name].file_size
            if size != expected:
                raise _damaged(self.path, f"{expected} bytes in {name} by the manifest", f"{size}")


def _frame_folder(index: int) -> str:
    return f"frames/{index:06d}"


def _sizes(manifest: SceneManifest) -> Iterator[tuple[str, int]]:
    """Names of all arrays of a scene, and their bytes."""
    folders = [(_frame_folder(index), points) for index, points in enumerate(manifest.points)]
    if manifest.background is not None:
        if manifest.background.shadow:
            for folder, _ in folders:
                yield f"{folder}/{SHADOW}", manifest.background.points
        folders.append((BACKGROUND, manifest.background.points))
    for folder, points in folders:
        for attribute in ATTRIBUTES:
            yield f"{folder}/{attribute.name}", attribute.nbytes(points, manifest.view_count)


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
