"""The container format of binary glTF 2.0 files (GLB): a header, a JSON part and a binary part."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from fourd.base.cameras import Array
from fourd.base.errors import UserError
from fourd.base.files import atomic_path
from fourd.base.limits import MAX_TEXT_BYTES, open_regular

MAGIC = 0x46546C67
JSON_CHUNK = 0x4E4F534A
BINARY_CHUNK = 0x004E4942
MAX_BYTES = (1 << 32) - 1
FLOAT, UINT8, UINT16, UINT32 = 5126, 5121, 5123, 5125
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
_COLUMNS = {name: columns for columns, name in _TYPES.items()}
_DTYPES = {FLOAT: "<f4", UINT8: "u1", UINT16: "<u2", UINT32: "<u4"}


@dataclass(frozen=True, eq=False)
class GlbFile:
    """A GLB file's JSON document and the position of its binary part. The document is not checked.

    The methods raise ValueError with a text of the form "expected ..., got ..." for bytes that are not in the file, and
    KeyError, IndexError or TypeError for a document of another structure. :func:`name_errors` turns all of them into a
    UserError.

    Attributes:
        path: the file.
        document: the glTF document.
        start: byte offset of the binary part in the file.
        length: length in bytes of the binary part.
    """

    path: Path
    document: dict[str, Any]
    start: int
    length: int

    def view(self, index: int) -> bytes:
        """Read the bytes of the buffer view ``index``."""
        view = self.document["bufferViews"][whole(index)]
        start, length = whole(view.get("byteOffset", 0)), whole(view["byteLength"])
        if start + length > self.length:
            raise ValueError(f"expected at least {start + length} bytes of binary data, got {self.length}")
        with open_regular(self.path) as stream:
            stream.seek(self.start + start)
            return stream.read(length)

    def array(self, index: int, columns: int) -> NDArray[Any]:
        """Read the array (N, columns) of an accessor. Normalised integers become floats in [0, 1]."""
        accessor = self.document["accessors"][whole(index)]
        kind, given = np.dtype(_DTYPES[accessor["componentType"]]), _COLUMNS[accessor["type"]]
        if (
            given < columns
            or "sparse" in accessor
            or "byteStride" in self.document["bufferViews"][accessor["bufferView"]]
        ):
            raise ValueError("expected plain arrays as fourd writes them, got sparse or interleaved ones")
        count, offset = whole(accessor["count"]), whole(accessor.get("byteOffset", 0))
        content = self.view(accessor["bufferView"])
        if offset + count * given * kind.itemsize > len(content):
            raise ValueError(f"expected {count} elements, got {len(content)} bytes, which cannot contain them")
        array = np.frombuffer(content, kind, count * given, offset).reshape(count, given)[:, :columns]
        return array / np.iinfo(kind).max if accessor.get("normalized") and kind.kind == "u" else array


def read_glb(path: Path) -> GlbFile:
    """Read the JSON part of a GLB file. The binary part is read only when an array is requested.

    Raises:
        UserError: if the file is missing, is damaged or is not a GLB file.
    """
    with name_errors(path), open_regular(path) as stream:
        size = os.fstat(stream.fileno()).st_size
        magic, version, total = struct.unpack("<III", stream.read(12))
        length, kind = struct.unpack("<II", stream.read(8))
        if magic != MAGIC or version != 2 or kind != JSON_CHUNK:
            raise ValueError("expected a GLB file of version 2, got another file")
        if total != size or size > MAX_BYTES:
            raise ValueError(f"expected {total} bytes according to the header, got {size}")
        if length > MAX_TEXT_BYTES:
            raise ValueError(f"expected at most {MAX_TEXT_BYTES >> 20} MB of JSON, got {length >> 20} MB")
        document = json.loads(stream.read(length).decode("utf-8"))
        binary_length, kind = struct.unpack("<II", stream.read(8))
        if kind != BINARY_CHUNK or not isinstance(document, dict):
            raise ValueError("expected a binary part, got another part")
        return GlbFile(path, document, stream.tell(), min(binary_length, size - stream.tell()))


@contextmanager
def name_errors(path: Path) -> Iterator[None]:
    """Turn the errors of a damaged GLB file, and of a document of another structure than fourd writes, into a
    UserError."""
    try:
        yield
    except OSError as error:
        raise UserError(f"{path}: expected a GLB file, got '{error.strerror}'; check the path") from error
    except (KeyError, IndexError, TypeError, AttributeError) as error:
        missing = f"a file without {error}" if isinstance(error, KeyError) else "a file of another structure"
        raise UserError(f"{path}: expected a mesh that fourd wrote, got {missing}; write the file again") from error
    except (ValueError, OverflowError, RecursionError, struct.error) as error:
        text = str(error) if str(error).startswith("expected ") else "expected an intact GLB file, got a damaged one"
        raise UserError(f"{path}: {text}; write the file again with fourd mesh") from error


def whole(value: object) -> int:
    """Return an index or a size of a document. Raises ValueError unless it is a whole number from 0."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError("expected whole numbers from 0 for indices and sizes, got other values")
    return value


def up_rotation(up: Array) -> list[float]:
    """Return the unit quaternion (x, y, z, w) of the smallest rotation that maps the direction ``up`` (3,) to the +y
    axis. ``up`` must not be zero."""
    x, y, z = np.asarray(up, np.float64) / np.linalg.norm(up)
    if y < -1 + 1e-12:
        return [1.0, 0.0, 0.0, 0.0]
    quaternion = np.array([-z, 0.0, x, 1 + y])
    return [float(value) for value in quaternion / np.linalg.norm(quaternion)]


def srgb_to_linear(values: NDArray[np.floating[Any]]) -> NDArray[np.float64]:
    """Convert sRGB colours in [0, 1] to linear colours in [0, 1] (IEC 61966-2-1), which glTF requires for vertices."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def float_accessor(view: int, array: NDArray[np.floating[Any]], *, has_limits: bool = False) -> dict[str, Any]:
    """Return the glTF accessor of an array (N, 1 to 4) that is stored as float32 in the buffer view ``view``.

    If ``has_limits`` is true, the accessor contains the smallest and largest values, which glTF requires for positions.
    """
    accessor = {"bufferView": view, "componentType": FLOAT, "count": len(array), "type": _TYPES[array.shape[1]]}
    if has_limits and len(array):
        accessor |= {"min": [float(v) for v in array.min(axis=0)], "max": [float(v) for v in array.max(axis=0)]}
    return accessor


def write_parts(path: Path, document: Mapping[str, Any], parts: Sequence[bytes], targets: Sequence[int | None]) -> None:
    """Write a GLB file atomically. ``parts[i]`` becomes the document's buffer view i.

    Args:
        path: the file.
        document: the glTF document without buffers and buffer views, which this function adds.
        parts: contents of the buffer views.
        targets: for each part, ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, or None for images.

    Raises:
        UserError: if the file would be larger than 4 GiB.
    """
    views: list[dict[str, Any]] = []
    offset = 0
    for part, target in zip(parts, targets, strict=True):
        view = {"buffer": 0, "byteOffset": offset, "byteLength": len(part)}
        views.append(view if target is None else view | {"target": target})
        offset += len(part) + -len(part) % 4
    whole = {**document, "bufferViews": views, "buffers": [{"byteLength": offset}]}
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        write_header(stream, whole, offset, str(path))
        for part in parts:
            stream.write(pad(part, b"\0"))


def pad(part: bytes, filler: bytes) -> bytes:
    """Append the byte ``filler`` until the length is a multiple of 4, which glTF requires for every part."""
    return part + filler * (-len(part) % 4)


def write_header(stream: BinaryIO, document: Mapping[str, Any], binary_length: int, name: str) -> None:
    """Write the part of a GLB file that precedes the binary data: the file header, the JSON ``document``, and the
    header of the binary data. ``binary_length`` is the length of the binary data in bytes and must be a multiple of 4.

    Raises:
        UserError: if the file would be larger than 4 GiB, the limit of the format. The error message starts with
            ``name``.
    """
    content = pad(json.dumps(document, separators=(",", ":")).encode("utf-8"), b" ")
    total = 12 + 8 + len(content) + 8 + binary_length
    if total > MAX_BYTES:
        raise UserError(
            f"{name}: expected at most 4 GiB, the limit of GLB files, got {total / 2**30:.1f} GiB; "
            "choose fewer --frames"
        )
    stream.write(struct.pack("<III", MAGIC, 2, total))
    stream.write(struct.pack("<II", len(content), JSON_CHUNK) + content)
    stream.write(struct.pack("<II", binary_length, BINARY_CHUNK))
