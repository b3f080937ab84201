"""Reading of the GLB files that `fourd mesh` and `fourd fit-triangles` write: one mesh with a texture or with vertex
colours."""

from __future__ import annotations

import io
import json
import os
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fourd.baking.meshes.mesh import Mesh
from fourd.errors import UserError
from fourd.formats.glb import BINARY_CHUNK, FLOAT, JSON_CHUNK, MAGIC, MAX_BYTES, UINT8, UINT32
from fourd.limits import MAX_TEXT_BYTES, open_regular

UINT16 = 5123
_TYPES = {FLOAT: "<f4", UINT8: "u1", UINT16: "<u2", UINT32: "<u4"}
_COLUMNS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_MAX_TEXTURE_SIDE = 1 << 13


def read_glb_mesh(path: Path) -> Mesh:
    """Read a mesh in the world coordinates of its capture.

    Raises:
        UserError: if the file is missing or damaged, or is not a GLB file with one mesh in the form that fourd writes.
    """
    try:
        document, binary = _read_parts(path)
        return _mesh(_Accessors(document, binary))
    except OSError as error:
        raise UserError(f"{path}: expected a GLB file, got '{error.strerror}'; check the path") from error
    except (KeyError, IndexError, TypeError) as error:
        missing = f"a file without {error}" if isinstance(error, KeyError) else "a file of another structure"
        raise UserError(f"{path}: expected a mesh that fourd wrote, got {missing}; write the file again") from error
    except (ValueError, RecursionError, struct.error) as error:
        text = str(error) if str(error).startswith("expected ") else "expected an intact GLB file, got a damaged one"
        raise UserError(f"{path}: {text}; write the file again with fourd mesh") from error


def _read_parts(path: Path) -> tuple[dict[str, Any], bytes]:
    with open_regular(path) as stream:
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
        return document, stream.read(binary_length)


class _Accessors:
    """Reads arrays from the binary part of the file, and checks that they lie inside it."""

    def __init__(self, document: dict[str, Any], binary: bytes) -> None:
        self.document = document
        self._binary = binary

    def view(self, index: int) -> bytes:
        view = self.document["bufferViews"][_whole(index)]
        start, length = _whole(view.get("byteOffset", 0)), _whole(view["byteLength"])
        if start + length > len(self._binary):
            raise ValueError(f"expected at least {start + length} bytes of binary data, got {len(self._binary)}")
        return self._binary[start : start + length]

    def array(self, index: int, columns: int) -> NDArray[Any]:
        """Return the array (N, columns) of an accessor. Normalised integers become floats in [0, 1]."""
        accessor = self.document["accessors"][_whole(index)]
        kind, given = np.dtype(_TYPES[accessor["componentType"]]), _COLUMNS[accessor["type"]]
        if (
            given < columns
            or "sparse" in accessor
            or "byteStride" in self.document["bufferViews"][accessor["bufferView"]]
        ):
            raise ValueError("expected plain arrays as fourd writes them, got sparse or interleaved ones")
        count, offset = _whole(accessor["count"]), _whole(accessor.get("byteOffset", 0))
        content = self.view(accessor["bufferView"])
        if offset + count * given * kind.itemsize > len(content):
            raise ValueError(f"expected {count} elements, got {len(content)} bytes, which cannot contain them")
        array = np.frombuffer(content, kind, count * given, offset).reshape(count, given)[:, :columns]
        return array / np.iinfo(kind).max if accessor.get("normalized") and kind.kind == "u" else array


def _mesh(accessors: _Accessors) -> Mesh:
    document = accessors.document
    meshes = document["meshes"]
    if len(meshes) != 1 or len(meshes[0]["primitives"]) != 1:
        raise ValueError(f"expected one mesh, got {len(meshes)} meshes, as in an animation; name the folder of frames")
    primitive = meshes[0]["primitives"][0]
    if primitive.get("mode", 4) != 4:
        raise ValueError("expected triangles, got points or lines")
    attributes = primitive["attributes"]
    indices = accessors.array(primitive["indices"], 1)
    if len(indices) % 3 or indices.dtype.kind != "u":
        raise ValueError(f"expected three indices for each triangle, got {len(indices)} indices")
    normals = attributes.get("NORMAL")
    texture = _texture(accessors) if "TEXCOORD_0" in attributes and document.get("images") else None
    return Mesh(
        xyz=accessors.array(attributes["POSITION"], 3).astype(np.float32),
        triangles=indices.astype(np.int64).clip(0, 2**31 - 1).astype(np.int32).reshape(-1, 3),
        normals=None if normals is None else accessors.array(normals, 3).astype(np.float32),
        rgb=_colours(accessors.array(attributes["COLOR_0"], 3)) if "COLOR_0" in attributes else None,
        uv=None if texture is None else accessors.array(attributes["TEXCOORD_0"], 2).astype(np.float32),
        texture=texture,
        up=_up(document),
    )


def _texture(accessors: _Accessors) -> NDArray[np.uint8]:
    content = io.BytesIO(accessors.view(accessors.document["images"][0]["bufferView"]))
    try:
        image = Image.open(content, formats=("JPEG", "PNG"))
        # The size is checked before the image is decoded, because a small file can declare a huge image.
        if max(image.size) > _MAX_TEXTURE_SIDE:
            got = f"{image.size[0]} x {image.size[1]}"
            raise ValueError(f"expected a texture of at most {_MAX_TEXTURE_SIDE} texels per side, got {got}")
        return np.asarray(image.convert("RGB"))
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise ValueError("expected a JPEG or PNG as texture, got a damaged image or another file") from error


def _colours(linear: NDArray[Any]) -> NDArray[np.uint8]:
    """Convert linear vertex colours in [0, 1] to sRGB bytes (IEC 61966-2-1)."""
    values = np.clip(linear.astype(np.float64), 0, 1)
    srgb = np.where(values <= 0.0031308, 12.92 * values, 1.055 * values ** (1 / 2.4) - 0.055)
    return np.rint(255 * srgb).astype(np.uint8)


def _up(document: dict[str, Any]) -> NDArray[np.float64]:
    """Return the direction, in vertex coordinates, that the root node rotates to +y."""
    root = document["nodes"][_whole(document["scenes"][0]["nodes"][0])]
    for node in document["nodes"]:
        if {"matrix", "scale", "translation"} & set(node):
            raise ValueError("expected nodes that only rotate, as fourd writes them, got another transform")
    x, y, z, w = (float(value) for value in root.get("rotation", (0, 0, 0, 1)))
    if not abs(x * x + y * y + z * z + w * w - 1) < 1e-3:
        raise ValueError("expected a unit quaternion as rotation of the root node, got another length")
    up = np.array([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)])
    return np.asarray(up / np.linalg.norm(up))


def _whole(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError("expected whole numbers from 0 for indices and sizes, got other values")
    return value
