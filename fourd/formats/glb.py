"""The container of binary glTF 2.0 files (GLB): a header, a JSON part and a binary part."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np

from fourd.cameras import Array
from fourd.errors import UserError

MAGIC = 0x46546C67
JSON_CHUNK = 0x4E4F534A
BINARY_CHUNK = 0x004E4942
MAX_BYTES = (1 << 32) - 1
FLOAT, UINT8, UINT32 = 5126, 5121, 5125
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963


def up_rotation(up: Array) -> list[float]:
    """Unit quaternion (x, y, z, w) of the shortest rotation of ``up`` (3,), not zero, to the axis +y."""
    x, y, z = np.asarray(up, np.float64) / np.linalg.norm(up)
    if y < -1 + 1e-12:
        return [1.0, 0.0, 0.0, 0.0]
    quaternion = np.array([-z, 0.0, x, 1 + y])
    return [float(value) for value in quaternion / np.linalg.norm(quaternion)]


def pad(part: bytes, filler: bytes) -> bytes:
    """Append ``filler`` until the length is a multiple of 4, which glTF demands of every part."""
    return part + filler * (-len(part) % 4)


def write_header(stream: BinaryIO, document: Mapping[str, Any], binary_length: int, name: str) -> None:
    """Write everything before the binary part, whose length in bytes is a multiple of 4.

    Raises:
        UserError: if the file would be larger than 4 GiB, the limit of the format. ``name`` is used in the message.
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
