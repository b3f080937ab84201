"""The container format of binary glTF 2.0 files (GLB): a header, a JSON part and a binary part."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Array
from fourd.errors import UserError
from fourd.files import atomic_path

MAGIC = 0x46546C67
JSON_CHUNK = 0x4E4F534A
BINARY_CHUNK = 0x004E4942
MAX_BYTES = (1 << 32) - 1
FLOAT, UINT8, UINT32 = 5126, 5121, 5125
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}


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
