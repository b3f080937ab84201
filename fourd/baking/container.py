"""The `.4dv` file: a ZIP64 with manifest.json and one member per frame and attribute. A member is a file inside the
ZIP.

A full scene also stores the attributes of its background once. A full scene can also store one shadow per frame.

Members are stored uncompressed, so that a seek or an HTTP range request can read one frame. The reader treats the file
as untrusted: before it allocates memory, it compares the members' sizes with the manifest. The reader skips unknown
members.
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

from fourd.baking.combine import combine_frames
from fourd.baking.manifest import ManifestError, NewerVersionError, manifest_from_json, manifest_to_json
from fourd.baking.scene import FULL_VERSION, OBJECT_VERSION, BakedFrame, SceneBackground, SceneManifest, make_frame
from fourd.errors import UserError
from fourd.files import atomic_path

MANIFEST_NAME = "manifest.json"
MAX_MANIFEST_BYTES = 64 << 20
BACKGROUND = "background"
"""Folder inside the ZIP that contains the arrays of the background."""
SHADOW = "shadow"
_TIMESTAMP = (1980, 1, 1, 0, 0, 0)
_ENCRYPTED = 0x1
_ZIP_ERRORS = (
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
    """Return the path of a frame's array inside the ZIP."""
    return f"{_frame_folder(frame)}/{attribute}"


class SceneWriter:
    """Writes a scene frame by frame. Memory use does not grow with the number of frames.

    Use the writer as a context manager: the complete file appears at ``path`` when the block ends. If the block raises
    an exception, an existing file at ``path`` is kept and no partial file remains.

    Args:
        path: path of the `.4dv`. A missing folder is created.
        manifest: manifest of the scene. The writer sets ``points``, ``background``, ``version`` and
            ``optional_attributes`` from the added frames.

    Raises:
        UserError: if the disk is full or the path cannot be written.
        ValueError: if frames are not added in order, if they do not match the manifest or each other, if they contain
            values that :data:`fourd.baking.attributes.ATTRIBUTES` excludes, or if the background of a full scene is not
            added exactly once.
    """

    def __init__(self, path: Path | str, manifest: SceneManifest) -> None:
        self.path = Path(path)
        self.manifest = manifest
        self._points: list[int] = []
        self._background: int | None = None  # number of points; None until the background is added
        self._shadow: int | None = None  # length of the frames' shadows; None without shadows
        self._optional: tuple[str, ...] | None = None  # attribute names; None until points are added
        self._stack = ExitStack()
        self._zip: zipfile.ZipFile | None = None

    def __enter__(self) -> SceneWriter:
        with _disk_errors(self.path), ExitStack() as stack:
            temporary = stack.enter_context(atomic_path(self.path))
            self._zip = zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED, allowZip64=True)
            self._stack = stack.pop_all()
        return self

    def add_frame(self, index: int, frame: BakedFrame, shadow: NDArray[np.uint8] | None = None) -> None:
        """Append frame ``index``. Frames must be added in order, starting at 0.

        Args:
            frame: the points of this frame, without the background.
            shadow: (M,) uint8 factors that multiply the colours of the M background points in this frame, in units of
                1/128. Only full scenes have shadows. Either all frames have a shadow or no frame has one.
        """
        if index != len(self._points) or index >= self.manifest.frame_count:
            raise ValueError(
                f"index: expected frame {len(self._points)} of {self.manifest.frame_count} next, got {index}"
            )
        self._check(f"frame {index}", frame)
        if shadow is not None or self._shadow is not None:
            self._check_shadow(index, shadow)
        self._write_arrays(_frame_folder(index), frame)
        if shadow is not None:
            self._write_array(member_name(index, SHADOW), shadow)
            self._shadow = len(shadow)
        self._points.append(frame.point_count)

    def add_background(self, frame: BakedFrame) -> None:
        """Add the static points of a full scene.

        Call this method exactly once. The background may be added before, between or after the frames.
        """
        if self.manifest.kind != "full":
            raise ValueError(f'expected no background in a scene of kind "{self.manifest.kind}", got one')
        if self._background is not None:
            raise ValueError("background: expected one background, got a second one")
        self._check("background", frame)
        if self._shadow not in (None, frame.point_count):
            raise ValueError(
                f"background: expected {self._shadow} points to match the frames' shadows, got {frame.point_count}"
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
            self.manifest = self._complete_manifest()
            self._write(MANIFEST_NAME, manifest_to_json(self.manifest))

    def _complete_manifest(self) -> SceneManifest:
        if len(self._points) != self.manifest.frame_count:
            raise ValueError(f"expected {self.manifest.frame_count} frames, got {len(self._points)}")
        manifest = replace(self.manifest, points=tuple(self._points), optional_attributes=self._optional or ())
        if manifest.kind == "object":
            return replace(manifest, version=OBJECT_VERSION)
        if self._background is None:
            raise ValueError('expected a background in a scene of kind "full", got none; call add_background')
        background = SceneBackground(self._background, shadow=self._shadow is not None)
        return replace(manifest, background=background, version=FULL_VERSION)

    def _check(self, what: str, frame: BakedFrame) -> None:
        if frame.view_count != self.manifest.view_count:
            raise ValueError(f"{what}: expected {self.manifest.view_count} source views, got {frame.view_count}")
        optional = tuple(item.name for item in frame.attributes if item.is_optional)
        if self._optional not in (None, optional):
            raise ValueError(f"{what}: expected the optional attributes {self._optional}, got {optional}")
        self._optional = optional
        invalid = frame.find_invalid_array()
        if invalid is not None:
            raise ValueError(f"{what}, {invalid}: expected finite numbers (radius and weights >= 0, density in [0, 1])")

    def _check_shadow(self, index: int, shadow: NDArray[np.uint8] | None) -> None:
        if self.manifest.kind != "full":
            raise ValueError(f'frame {index}: expected no shadow in a scene of kind "{self.manifest.kind}", got one')
        if shadow is None:
            raise ValueError(f"frame {index}: expected a shadow, because the previous frames have one, got none")
        if self._shadow is None and index > 0:
            raise ValueError(f"frame {index}: expected no shadow, because the previous frames have none, got one")
        length = self._shadow if self._background is None else self._background
        if shadow.dtype != np.uint8 or shadow.ndim != 1 or length not in (None, len(shadow)):
            points = "M" if length is None else length
            raise ValueError(
                f"frame {index}, shadow: expected uint8 of shape ({points},), "
                f"got {shadow.dtype} of shape {shadow.shape}"
            )

    def _write_arrays(self, folder: str, frame: BakedFrame) -> None:
        arrays = frame.arrays
        for attribute in frame.attributes:
            array = arrays[attribute.name].astype(attribute.dtype, copy=False)
            self._write_array(f"{folder}/{attribute.name}", array)

    def _write_array(self, name: str, array: NDArray[Any]) -> None:
        with _disk_errors(self.path):
            self._write(name, np.ascontiguousarray(array).data.cast("B") if array.size else b"")

    def _write(self, name: str, content: bytes | memoryview) -> None:
        assert self._zip is not None
        info = zipfile.ZipInfo(name, _TIMESTAMP)
        info.external_attr = 0o644 << 16
        self._zip.writestr(info, content)


class SceneReader:
    """Reads a `.4dv`. Every call reads the requested frame from the file. Only the background is cached.

    Several threads may use one instance.

    Raises:
        UserError: if the file is truncated, is not a scene, has a newer format or is inconsistent. An invalid file
            raises UserError when it is opened. A damaged member of the ZIP raises UserError when the member is read.
            The message is one line that names the file and the fix.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self._zip = _open_zip(self.path)
        self._background: BakedFrame | None = None
        self._lock = Lock()
        try:
            self._members = _check_members(self.path, self._zip)
            self.manifest = self._read_manifest()
            self._check_sizes()
        except BaseException:
            self._zip.close()
            raise

    def close(self) -> None:
        """Close the file and release the background. Later reads raise ValueError."""
        self._zip.close()
        self._background = None

    def read(self, index: int) -> BakedFrame:
        """Read frame ``index``, from 0: the dynamic points, followed by the background points with the frame's shadow.

        The arrays are read-only. Raises IndexError if the scene has no such frame.
        """
        dynamic = self.read_dynamic(index)
        background = self.read_background()
        return dynamic if background is None else combine_frames(dynamic, background, self.read_shadow(index))

    def read_dynamic(self, index: int) -> BakedFrame:
        """Read the dynamic points of frame ``index``. Raises IndexError if the scene has no such frame."""
        self._require_frame(index)
        return self._read(_frame_folder(index), self.manifest.points[index])

    def read_background(self) -> BakedFrame | None:
        """Return the cached background points, without shadows. Returns None for an object scene."""
        described = self.manifest.background
        if described is None:
            return None
        with self._lock:
            if self._background is None:
                self._background = self._read(BACKGROUND, described.points)
            return self._background

    def read_shadow(self, index: int) -> NDArray[np.uint8] | None:
        """Read a frame's shadow factors, (M,) uint8 in units of 1/128. Returns None if the scene has no shadows.

        Raises IndexError if the scene has no such frame.
        """
        self._require_frame(index)
        if self.manifest.background is None or not self.manifest.background.shadow:
            return None
        return np.frombuffer(self._content(member_name(index, SHADOW)), np.uint8)

    def _require_frame(self, index: int) -> None:
        if not 0 <= index < self.manifest.frame_count:
            raise IndexError(f"frame: expected 0 to {self.manifest.frame_count - 1}, got {index}")

    def _read(self, folder: str, points: int) -> BakedFrame:
        arrays: dict[str, NDArray[Any]] = {}
        for attribute in self.manifest.attributes:
            content = self._content(f"{folder}/{attribute.name}")
            shape = attribute.resolve_shape(points, self.manifest.view_count)
            arrays[attribute.name] = np.frombuffer(content, dtype=attribute.dtype).reshape(shape)
        frame = make_frame(arrays)
        invalid = frame.find_invalid_array()
        if invalid is not None:
            name = f"{folder}/{invalid}"
            raise _damaged(self.path, f"finite numbers in {name}", "NaN, infinity or a value out of range")
        return frame

    def _content(self, name: str) -> bytes:
        if self._zip.fp is None:
            raise ValueError(f"{self.path}: expected an open scene, got a closed one")
        try:
            return self._zip.read(self._members[name])
        except _ZIP_ERRORS as error:
            raise _damaged(self.path, f"an intact member {name}", str(error) or "the end of the file") from error
        except OSError as error:
            raise UserError(f"{self.path}: cannot be read ({error}); check the disk") from error

    def _read_manifest(self) -> SceneManifest:
        if MANIFEST_NAME not in self._members:
            raise _damaged(self.path, f"a scene that contains {MANIFEST_NAME}", "a ZIP without it")
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
        for name, expected in _member_sizes(self.manifest):
            if name not in self._members:
                raise _damaged(self.path, f"a member {name}", "none")
            size = self._members[name].file_size
            if size != expected:
                raise _damaged(self.path, f"{expected} bytes in {name} according to the manifest", f"{size}")


def _frame_folder(index: int) -> str:
    return f"frames/{index:06d}"


def _member_sizes(manifest: SceneManifest) -> Iterator[tuple[str, int]]:
    """Yield the names of all arrays of a scene and their sizes in bytes."""
    folders = [(_frame_folder(index), points) for index, points in enumerate(manifest.points)]
    if manifest.background is not None:
        if manifest.background.shadow:
            for folder, _ in folders:
                yield f"{folder}/{SHADOW}", manifest.background.points
        folders.append((BACKGROUND, manifest.background.points))
    for folder, points in folders:
        for attribute in manifest.attributes:
            yield f"{folder}/{attribute.name}", attribute.nbytes(points, manifest.view_count)


def _open_zip(path: Path) -> zipfile.ZipFile:
    if path.is_dir():
        raise UserError(f"{path}: expected a .4dv file, got a folder; name the file that fourd export wrote")
    try:
        return zipfile.ZipFile(path)
    except FileNotFoundError as error:
        raise UserError(f"{path}: expected a .4dv file, got a path that does not exist; check the path") from error
    except _ZIP_ERRORS as error:
        raise UserError(
            f"{path}: expected a complete .4dv scene (a ZIP), got a truncated file or another kind of file; "
            "copy or export it again"
        ) from error
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error}); check its permissions") from error


def _check_members(path: Path, archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    members: dict[str, zipfile.ZipInfo] = {}
    size, total = path.stat().st_size, 0
    for info in archive.infolist():
        name = info.filename
        if name.startswith("/") or "\\" in name or ":" in name or ".." in name.split("/"):
            raise _damaged(path, "member names inside the archive", repr(name[:80]))
        if name in members:
            raise _damaged(path, "every member once", f"{name!r} twice")
        if info.flag_bits & _ENCRYPTED:
            raise UserError(
                f"{path}: expected unencrypted members, got the encrypted member {name!r}; export the scene again"
            )
        if info.compress_type != zipfile.ZIP_STORED or info.compress_size != info.file_size:
            raise UserError(
                f"{path}: expected uncompressed members, got the compressed member {name!r}; use zip -0 or export again"
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
