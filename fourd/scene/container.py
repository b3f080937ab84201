"""The `.4dv` file: a ZIP64 archive with manifest.json and one member (file inside the archive) per frame and attribute.

The archive of a full scene (a scene with a static background) also contains each attribute of the background, once for
all frames, and can contain one shadow per frame.

Members are stored without ZIP compression, so that one frame can be read with a seek or an HTTP range request. (In
packed scenes, the content of a member is compressed before it is stored.) The reader treats the file as untrusted: it
compares the members' sizes with the manifest before it allocates memory. It skips members that it does not know.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from threading import Lock
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.base.errors import UserError
from fourd.base.files import atomic_path, remove_unfinished_file
from fourd.base.storage import Location, local_path, parse_location
from fourd.recording.soundtrack.ogg import OggError
from fourd.scene.combine import combine_frames
from fourd.scene.files.archive import (
    ZIP_ERRORS,
    archive_size,
    check_members,
    damaged,
    disk_errors,
    make_member,
    open_zip,
)
from fourd.scene.files.encoding import CloudEncoding
from fourd.scene.files.sound import SOUND_NAME, OpusSound, check_sound
from fourd.scene.manifest import ManifestError, NewerVersionError, manifest_from_json, manifest_to_json
from fourd.scene.packed.members import decode_cloud, optional_member, packed_names
from fourd.scene.packed.names import BACKGROUND, MANIFEST_NAME, SHADOW, frame_folder, member_name, member_sizes
from fourd.scene.packed.streams import StreamError, decompress_exactly
from fourd.scene.scene import (
    FULL_VERSION,
    OBJECT_VERSION,
    SOUND_VERSION,
    BakedFrame,
    SceneBackground,
    SceneManifest,
    make_frame,
)

MAX_MANIFEST_BYTES = 64 << 20


class SceneWriter:
    """Writes a scene to a file, one frame after the other. Memory use does not grow with the number of frames.

    Use the writer as a context manager: the complete file appears at ``path`` when the ``with`` block ends. If the
    block raises an exception, no partial file remains, and an existing file at ``path`` is unchanged.

    Args:
        path: path of the `.4dv`. Missing folders of ``path`` are created.
        manifest: manifest of the scene. The writer sets ``points``, ``background``, ``version``, ``sound`` and
            ``optional_attributes`` from what is added.

    Raises:
        UserError: if the disk is full, the path cannot be written, or the path is a URL (see
            :func:`fourd.base.storage.upload`).
        ValueError: if frames are not added in order, do not match the manifest or each other, or contain values that
            :data:`fourd.scene.attributes.ATTRIBUTES` excludes. ValueError is also raised if the background of a full
            scene is not added exactly once.
    """

    def __init__(self, path: Path | str, manifest: SceneManifest) -> None:
        self.path = local_path(path, "write a scene")
        self.manifest = replace(manifest, sound=None)
        self._points: list[int] = []
        self._background: int | None = None  # number of points; None until the background is added
        self._shadow: int | None = None  # length of the frames' shadows; None without shadows
        self._optional: tuple[str, ...] | None = None  # attribute names; None until points are added
        self._stack = ExitStack()
        self._zip: zipfile.ZipFile | None = None

    def __enter__(self) -> SceneWriter:
        with disk_errors(self.path), ExitStack() as stack:
            remove_unfinished_file(self.path)
            temporary = stack.enter_context(atomic_path(self.path))
            self._zip = zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED, allowZip64=True)
            self._stack = stack.pop_all()
        return self

    def add_frame(self, index: int, frame: BakedFrame, shadow: NDArray[np.uint8] | None = None) -> None:
        """Append frame ``index``. Frames must be added in order, starting at 0.

        Args:
            frame: the points of this frame, without the background.
            shadow: (M,) uint8 factors, in units of 1/128, that multiply the colours of the M background points in this
                frame. Only full scenes have shadows, and either all frames have one or none has.
        """
        if index != len(self._points) or index >= self.manifest.frame_count:
            raise ValueError(
                f"index: expected frame {len(self._points)} of {self.manifest.frame_count} next, got {index}"
            )
        self._check(f"frame {index}", frame)
        if shadow is not None or self._shadow is not None:
            self._check_shadow(index, shadow)
        self._write_arrays(frame_folder(index), frame)
        if shadow is not None:
            self._write_array(member_name(index, SHADOW), shadow)
            self._shadow = len(shadow)
        self._points.append(frame.point_count)

    def add_background(self, frame: BakedFrame) -> None:
        """Add the static background points. The scene must be a full scene, which is a scene with a background.

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

    def add_sound(self, sound: OpusSound) -> None:
        """Add the sound, at most once. Raises ValueError if it is not valid, or does not end with the scene."""
        if self.manifest.sound is not None:
            raise ValueError("sound: expected one sound, got a second one")
        described = sound.describe()
        described.require_inside(self.manifest.seconds)
        with disk_errors(self.path):
            self._write(SOUND_NAME, sound.content)
        self.manifest = replace(self.manifest, sound=described)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._zip is not None
        if error is not None:
            with suppress(OSError, ValueError):
                self._zip.close()
            self._stack.__exit__(kind, error, trace)
            return
        with disk_errors(self.path), self._stack, self._zip:
            self.manifest = self._complete_manifest()
            self._write(MANIFEST_NAME, manifest_to_json(self.manifest))

    def _complete_manifest(self) -> SceneManifest:
        if len(self._points) != self.manifest.frame_count:
            raise ValueError(f"expected {self.manifest.frame_count} frames, got {len(self._points)}")
        manifest = replace(self.manifest, points=tuple(self._points), optional_attributes=self._optional or ())
        has_sound = manifest.sound is not None
        if manifest.kind == "object":
            return replace(manifest, version=SOUND_VERSION if has_sound else OBJECT_VERSION)
        if self._background is None:
            raise ValueError('expected a background in a scene of kind "full", got none; call add_background')
        background = SceneBackground(self._background, shadow=self._shadow is not None)
        return replace(manifest, background=background, version=SOUND_VERSION if has_sound else FULL_VERSION)

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
        with disk_errors(self.path):
            self._write(name, np.ascontiguousarray(array).data.cast("B") if array.size else b"")

    def _write(self, name: str, content: bytes | memoryview) -> None:
        assert self._zip is not None
        self._zip.writestr(make_member(name), content)


class SceneReader:
    """Reads a `.4dv`. Each call reads the requested frame from the file; only the background is kept in memory.

    Several threads may use one instance at the same time. ``path`` can be a URL, such as s3://bucket/scene.4dv. A scene
    at a URL is read with range requests, without a local copy.

    Attributes:
        path: the path or URL of the file.
        size: size of the file in bytes.
        manifest: the scene's manifest.

    Raises:
        UserError: if the file is truncated, is not a scene, has a newer format or is inconsistent. The error is raised
            when an invalid file is opened, or when a damaged member of the ZIP is read. The message is one line that
            names the file and says how to solve the problem.
    """

    def __init__(self, path: Location | str) -> None:
        self.path = parse_location(path)
        self._zip = open_zip(self.path)
        self._background: BakedFrame | None = None
        self._lock = Lock()
        try:
            self.size = archive_size(self._zip)
            self._members = check_members(self.path, self._zip)
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
        """Read the frame with the 0-based ``index``: the dynamic points, followed by the background points with the
        frame's shadow.

        The arrays are read-only. Raises IndexError if the scene has no frame ``index``.
        """
        dynamic = self.read_dynamic(index)
        background = self.read_background()
        return dynamic if background is None else combine_frames(dynamic, background, self.read_shadow(index))

    def read_dynamic(self, index: int) -> BakedFrame:
        """Read the dynamic points of frame ``index``. Raises IndexError if the scene has no frame ``index``."""
        self._require_frame(index)
        encoding = self.manifest.encoding
        return self._read(
            frame_folder(index), self.manifest.points[index], None if encoding is None else encoding.dynamic
        )

    def read_background(self) -> BakedFrame | None:
        """Return the cached background points, without shadows, or None for an object scene (a scene without a
        background)."""
        described = self.manifest.background
        if described is None:
            return None
        with self._lock:
            if self._background is None:
                encoding = self.manifest.encoding
                self._background = self._read(
                    BACKGROUND, described.points, None if encoding is None else encoding.background
                )
            return self._background

    def read_shadow(self, index: int) -> NDArray[np.uint8] | None:
        """Read a frame's shadow factors, which multiply the colours of the M background points. Returns (M,) uint8 in
        units of 1/128, or None if the scene has no shadows.

        Raises IndexError if the scene has no frame ``index``.
        """
        self._require_frame(index)
        if self.manifest.background is None or not self.manifest.background.shadow:
            return None
        name = member_name(index, SHADOW)
        content = self.read_member(name)
        if self.manifest.encoding is None:
            return np.frombuffer(content, np.uint8)
        with self._decoding(name):
            return decompress_exactly(content, self.manifest.background.points)

    def read_sound(self) -> OpusSound | None:
        """Return the sound, of which the headers were checked, or None if the scene has none. Raises UserError."""
        described = self.manifest.sound
        if described is None:
            return None
        content = self.read_member(SOUND_NAME)
        try:
            check_sound(content, described)
        except OggError as error:
            expected, _, got = str(error).removeprefix("expected ").partition(", got ")
            raise damaged(self.path, f"{expected} in {SOUND_NAME}", got) from error
        return OpusSound(content, described.start)

    def _require_frame(self, index: int) -> None:
        if not 0 <= index < self.manifest.frame_count:
            raise IndexError(f"frame: expected 0 to {self.manifest.frame_count - 1}, got {index}")

    def _read(self, folder: str, points: int, encoding: CloudEncoding | None) -> BakedFrame:
        arrays = self._read_arrays(folder, points) if encoding is None else self._unpack(folder, points, encoding)
        frame = make_frame(arrays)
        invalid = frame.find_invalid_array()
        if invalid is not None:
            name = f"{folder}/{invalid}"
            raise damaged(self.path, f"finite numbers in {name}", "NaN, infinity or a value out of range")
        return frame

    def _read_arrays(self, folder: str, points: int) -> dict[str, NDArray[Any]]:
        arrays: dict[str, NDArray[Any]] = {}
        for attribute in self.manifest.attributes:
            content = self.read_member(f"{folder}/{attribute.name}")
            shape = attribute.resolve_shape(points, self.manifest.view_count)
            arrays[attribute.name] = np.frombuffer(content, dtype=attribute.dtype).reshape(shape)
        return arrays

    def _unpack(self, folder: str, points: int, encoding: CloudEncoding) -> dict[str, NDArray[Any]]:
        """Decode all arrays of a compressed point cloud (a frame or the background) from the files in ``folder`` inside
        the ZIP."""
        views = self.manifest.view_count
        members = {name: self.read_member(f"{folder}/{name}") for name in packed_names(self.manifest)}
        with self._decoding(folder):
            arrays = decode_cloud(members, points, self.manifest.source_cameras, encoding)
            for attribute in self.manifest.attributes:
                if attribute.is_optional:
                    size, shape = attribute.nbytes(points, views), attribute.resolve_shape(points, views)
                    content = decompress_exactly(members[optional_member(attribute.name)], size)
                    arrays[attribute.name] = content.view(attribute.dtype).reshape(shape)
        return arrays

    @contextmanager
    def _decoding(self, name: str) -> Iterator[None]:
        """Raise a UserError with the file's name if the code in the ``with`` block finds a damaged member."""
        try:
            yield
        except StreamError as error:
            expected, _, got = str(error).removeprefix("expected ").partition(", got ")
            raise damaged(self.path, f"{expected} in {name}", got) from error

    def read_member(self, name: str) -> bytes:
        """Return the stored bytes of a member (a file inside the ZIP). Raises KeyError if there is no such member, and
        UserError if the member is damaged or cannot be read."""
        if self._zip.fp is None:
            raise ValueError(f"{self.path}: expected an open scene, got a closed one")
        try:
            return self._zip.read(self._members[name])
        except ZIP_ERRORS as error:
            raise damaged(self.path, f"an intact member {name}", str(error) or "the end of the file") from error
        except OSError as error:
            raise UserError(f"{self.path}: cannot be read ({error}); check the disk") from error

    def _read_manifest(self) -> SceneManifest:
        if MANIFEST_NAME not in self._members:
            raise damaged(self.path, f"a scene that contains {MANIFEST_NAME}", "a ZIP without it")
        size = self._members[MANIFEST_NAME].file_size
        if size > MAX_MANIFEST_BYTES:
            raise damaged(self.path, f"at most {MAX_MANIFEST_BYTES} bytes of {MANIFEST_NAME}", f"{size}")
        try:
            return manifest_from_json(self.read_member(MANIFEST_NAME))
        except NewerVersionError as error:
            raise UserError(f"{self.path}: {error}; update fourd to open this newer scene") from error
        except ManifestError as error:
            raise UserError(f"{self.path}: {error}; export the scene again") from error

    def _check_sizes(self) -> None:
        for name, expected in member_sizes(self.manifest):
            if name not in self._members:
                raise damaged(self.path, f"a member {name}", "none")
            size = self._members[name].file_size
            if expected is not None and size != expected:
                raise damaged(self.path, f"{expected} bytes in {name} according to the manifest", f"{size}")
