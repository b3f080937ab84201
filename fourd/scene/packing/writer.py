"""Writes packed scenes. The first member (file inside the ZIP) is the manifest. It contains the offsets of all other
members, so that a player on a network can fetch any frame as soon as it has the manifest.
"""

from __future__ import annotations

import json
import struct
import zipfile
import zlib
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType

from fourd.base.files import atomic_path, remove_unfinished_file
from fourd.scene.files.archive import disk_errors, make_member, open_zip
from fourd.scene.files.sound import SOUND_NAME, OpusSound
from fourd.scene.manifest import manifest_to_json
from fourd.scene.packed.members import optional_member, packed_names, view_member
from fourd.scene.packed.names import BACKGROUND, MANIFEST_NAME, SHADOW, frame_folder
from fourd.scene.packed.streams import Compression, compress
from fourd.scene.scene import PACKED_VERSION, SOUND_VERSION, VIDEO_VERSION, SceneManifest

_BYTES_PER_MEMBER = 64
"""Bytes that are reserved in the manifest for the name, the offset and the size of one member."""
_BYTES_PER_FRAME = 64
"""Bytes that are reserved in the manifest for the number and the point count of one frame."""
_LOCAL_HEADER = struct.Struct("<4s5H3L2H")
_CRC_OFFSET = 14
"""Offset of the CRC-32 checksum in the local header of a member, in bytes (ZIP appnote 4.3.7)."""


@dataclass(frozen=True)
class Storage:
    """Compression and order of the members of a packed scene.

    Attributes:
        compression: compression of all members. Web browsers can only decompress "zlib".
        view_order: order of the source views of each cloud in the file; empty for the order of the manifest. It matters
            because a player on a network reads adjacent views with one request.
    """

    compression: Compression = "zstd"
    view_order: tuple[int, ...] = ()


class PackedWriter:
    """Writes a packed scene, one member after the other. Memory use does not grow with the number of frames.

    Use the writer as a context manager: the complete file appears at ``path`` when the ``with`` block ends. If the
    block raises an exception, no partial file remains, and an existing file at ``path`` is unchanged.

    Args:
        path: path of the `.4dv`. Missing folders of ``path`` are created.
        manifest: manifest of the scene, with ``points``, ``background`` and ``encoding``. The values in ``points`` are
            upper limits; the written file contains the actual numbers of points of the added frames.
        storage: compression and order of the members.
        sound: the sound of the scene, or None. It replaces the ``sound`` of the manifest.

    Raises:
        UserError: if the disk is full or the path cannot be written.
    """

    def __init__(
        self, path: Path | str, manifest: SceneManifest, storage: Storage | None = None, sound: OpusSound | None = None
    ) -> None:
        self.path = Path(path)
        has_images = manifest.encoding is not None and manifest.encoding.tier == "video"
        described = None if sound is None else sound.describe()
        version = SOUND_VERSION if sound is not None else VIDEO_VERSION if has_images else PACKED_VERSION
        self.manifest = replace(manifest, version=version, sound=described)
        self._sound = sound
        self._storage = storage or Storage()
        self._stack = ExitStack()
        self._zip: zipfile.ZipFile | None = None
        self._temporary = self.path
        self._sizes: dict[str, int] = {}
        self._points: list[int] = []

    def __enter__(self) -> PackedWriter:
        with disk_errors(self.path), ExitStack() as stack:
            remove_unfinished_file(self.path)
            self._temporary = stack.enter_context(atomic_path(self.path))
            self._zip = zipfile.ZipFile(self._temporary, "w", zipfile.ZIP_STORED, allowZip64=True)
            self._zip.writestr(make_member(MANIFEST_NAME), b" " * self._manifest_room())
            if self._sound is not None:
                self._zip.writestr(make_member(SOUND_NAME), self._sound.content)
            self._stack = stack.pop_all()
        return self

    def add_frame(self, index: int, points: int, members: Mapping[str, bytes], shadow: bytes | None = None) -> int:
        """Compress and append the members of frame ``index``, which has ``points`` points.

        Frames must be added in order. Returns the compressed size in bytes.
        """
        self._points.append(points)
        content = dict(members) if shadow is None else {**members, SHADOW: shadow}
        return self._add(frame_folder(index), content)

    def add_background(self, members: Mapping[str, bytes]) -> int:
        """Compress and append the members of the background. Returns the compressed size in bytes."""
        return self._add(BACKGROUND, members)

    @property
    def sizes(self) -> dict[str, int]:
        """The compressed size, in bytes, of each member that was written so far."""
        return dict(self._sizes)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._zip is not None
        if error is not None:
            with suppress(OSError, ValueError):
                self._zip.close()
            self._stack.__exit__(kind, error, trace)
            return
        with disk_errors(self.path), self._stack:
            manifest = self._complete_manifest()
            # The checksum is set before close(), which writes it to the central directory of the ZIP.
            self._zip.getinfo(MANIFEST_NAME).CRC = zlib.crc32(manifest)
            self._zip.close()
            self._overwrite_manifest(manifest)

    def _add(self, folder: str, members: Mapping[str, bytes]) -> int:
        assert self._zip is not None
        total = 0
        views = [view_member(view) for view in self._storage.view_order]
        # Optional attributes are stored after the views, because most players do not fetch them.
        optional = [name for name in members if name.startswith(optional_member(""))]
        base = [name for name in members if name not in {*views, *optional}]
        names = [*base, *(name for name in views if name in members), *optional]
        for name in names:
            compressed = compress(members[name], self._storage.compression)
            with disk_errors(self.path):
                self._zip.writestr(make_member(f"{folder}/{name}"), compressed)
            self._sizes[f"{folder}/{name}"] = len(compressed)
            total += len(compressed)
        return total

    def _manifest_room(self) -> int:
        """Return an upper bound of the size of the complete manifest, in bytes."""
        frames = self.manifest.frame_count
        members = (frames + 1) * (len(packed_names(self.manifest)) + 1) + 1
        names = sum(len(name) for name in self.manifest.optional_attributes) * (frames + 1)
        content = len(manifest_to_json(self.manifest))
        return content + _BYTES_PER_MEMBER * members + names + _BYTES_PER_FRAME * frames

    def _complete_manifest(self) -> bytes:
        assert self._zip is not None
        content = json.loads(manifest_to_json(replace(self.manifest, points=tuple(self._points))))
        content["members"] = {
            info.filename: [info.header_offset + _LOCAL_HEADER.size + len(info.filename.encode()), info.file_size]
            for info in self._zip.infolist()
            if info.filename != MANIFEST_NAME
        }
        text = json.dumps(content, allow_nan=False, separators=(",", ":")).encode()
        return text.ljust(self._manifest_room())

    def _overwrite_manifest(self, manifest: bytes) -> None:
        """Write the manifest over the spaces that :meth:`__enter__` reserved for it, and correct the checksum in its
        ZIP header."""
        with open_zip(self._temporary) as archive:
            header = archive.getinfo(MANIFEST_NAME).header_offset
        with self._temporary.open("rb+") as stream:
            stream.seek(header + _CRC_OFFSET)
            stream.write(struct.pack("<L", zlib.crc32(manifest)))
            stream.seek(header + _LOCAL_HEADER.size + len(MANIFEST_NAME))
            stream.write(manifest)
