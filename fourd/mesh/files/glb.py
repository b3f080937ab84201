"""Writes textured meshes to GLB files (binary glTF 2.0), and reads the files that it wrote.

The vertices in a file are in world coordinates. glTF requires metres, right-handed axes and +y as the up axis, so the
root node rotates the scene's up direction to +y. Textures are embedded JPEG images. The material is unlit
(KHR_materials_unlit), because the images already contain the scene's lighting.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Array
from fourd.errors import UserError
from fourd.formats.glb import (
    ARRAY_BUFFER,
    BINARY_CHUNK,
    ELEMENT_ARRAY_BUFFER,
    JSON_CHUNK,
    MAGIC,
    UINT32,
    float_accessor,
    up_rotation,
    write_parts,
)
from fourd.limits import MAX_TEXT_BYTES, open_regular
from fourd.mesh.texturing.texture import TexturedMesh

LINEAR, LINEAR_MIPMAP_LINEAR, CLAMP_TO_EDGE = 9729, 9987, 33071
JPEG_QUALITY = 95
UNLIT = "KHR_materials_unlit"
ASSET = {"version": "2.0", "generator": "fourd mesh"}


@dataclass(frozen=True, eq=False)
class GlbFile:
    """A GLB file's JSON document and the position of its binary part.

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
        view = self.document["bufferViews"][index]
        with open_regular(self.path) as stream:
            stream.seek(self.start + view.get("byteOffset", 0))
            return stream.read(view["byteLength"])


def write_glb(path: Path, mesh: TexturedMesh, up: Array) -> None:
    """Write one textured mesh, atomically.

    Args:
        path: the file.
        mesh: the mesh in world coordinates.
        up: (3,) nonzero up direction of the scene in world coordinates.
    """
    image = encode_texture(mesh.texture)
    parts = [
        np.ascontiguousarray(mesh.xyz, "<f4").tobytes(),
        np.ascontiguousarray(mesh.normals, "<f4").tobytes(),
        np.ascontiguousarray(mesh.uv, "<f4").tobytes(),
        np.ascontiguousarray(mesh.triangles, "<u4").tobytes(),
        image,
    ]
    targets = (ARRAY_BUFFER, ARRAY_BUFFER, ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, None)
    write_parts(path, _document(mesh, up), parts, targets)


def read_glb(path: Path) -> GlbFile:
    """Read the JSON part of a GLB file.

    Raises:
        UserError: if the file is missing, is damaged or is not a GLB file.
    """
    try:
        with open_regular(path) as stream:
            magic, version, total = struct.unpack("<III", stream.read(12))
            length, kind = struct.unpack("<II", stream.read(8))
            if length > MAX_TEXT_BYTES:
                raise ValueError("a JSON part of more than 64 MB")
            if magic != MAGIC or version != 2 or kind != JSON_CHUNK or total != path.stat().st_size:
                raise ValueError(
                    "a file that is not GLB version 2, or whose length differs from the length in its header"
                )
            document = json.loads(stream.read(length).decode("utf-8"))
            binary_length, kind = struct.unpack("<II", stream.read(8))
            if kind != BINARY_CHUNK or not isinstance(document, dict):
                raise ValueError("no binary part")
            return GlbFile(path, document, stream.tell(), binary_length)
    except FileNotFoundError as error:
        raise UserError(f"{path}: expected a GLB file, got no such file; run fourd mesh") from error
    except (struct.error, ValueError, RecursionError) as error:
        raise UserError(f"{path}: expected an intact GLB file, got {error}; delete it and run fourd mesh") from error


def read_mesh(path: Path) -> TexturedMesh:
    """Read the first mesh of a GLB file that :func:`write_glb` wrote.

    Raises:
        UserError: if the file is missing or damaged, or its mesh lacks attributes that fourd writes.
    """
    file = read_glb(path)
    try:
        primitive = file.document["meshes"][0]["primitives"][0]
        attributes = primitive["attributes"]
        source = file.document["images"][0]["bufferView"]
        texture = cv2.imdecode(np.frombuffer(file.view(source), np.uint8), cv2.IMREAD_COLOR_RGB)
        if texture is None:
            raise ValueError("no readable texture")
        return TexturedMesh(
            _floats(file, attributes["POSITION"], 3),
            np.frombuffer(_accessor_bytes(file, primitive["indices"]), "<u4").astype(np.int32).reshape(-1, 3),
            _floats(file, attributes["NORMAL"], 3),
            _floats(file, attributes["TEXCOORD_0"], 2),
            np.asarray(texture, np.uint8),
        )
    except (KeyError, IndexError, TypeError, ValueError, OverflowError, OSError, cv2.error) as error:
        raise UserError(
            f"{path}: expected a textured mesh that fourd mesh wrote, got none ({error}); run fourd mesh again"
        ) from error


def encode_texture(texture: NDArray[np.uint8]) -> bytes:
    """Encode an RGB texture (S, S, 3) as JPEG without chroma subsampling."""
    flags = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY, cv2.IMWRITE_JPEG_SAMPLING_FACTOR]
    ok, code = cv2.imencode(".jpg", texture[..., ::-1], [*flags, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444])
    if not ok:
        raise RuntimeError("OpenCV could not encode the texture as JPEG")
    return code.tobytes()


def _document(mesh: TexturedMesh, up: Array) -> dict[str, Any]:
    accessors: list[dict[str, Any]] = [
        float_accessor(0, mesh.xyz, has_limits=True),
        float_accessor(1, mesh.normals),
        float_accessor(2, mesh.uv),
        {"bufferView": 3, "componentType": UINT32, "count": mesh.triangles.size, "type": "SCALAR"},
    ]
    attributes = {"POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2}
    return {
        "asset": ASSET,
        "extensionsUsed": [UNLIT],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "world", "rotation": up_rotation(up), "children": [1]}, {"name": "frame", "mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 3, "material": 0}]}],
        "materials": [material(0)],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [sampler()],
        "images": [{"bufferView": 4, "mimeType": "image/jpeg"}],
        "accessors": accessors,
    }


def material(texture: int) -> dict[str, Any]:
    """Return an unlit, textured material. Programs without support for unlit materials show a rough material
    instead."""
    return {
        "pbrMetallicRoughness": {"baseColorTexture": {"index": texture}, "metallicFactor": 0, "roughnessFactor": 1},
        "extensions": {UNLIT: {}},
    }


def sampler() -> dict[str, int]:
    """Return a sampler with trilinear filtering that clamps texture coordinates to the edge."""
    return {
        "magFilter": LINEAR,
        "minFilter": LINEAR_MIPMAP_LINEAR,
        "wrapS": CLAMP_TO_EDGE,
        "wrapT": CLAMP_TO_EDGE,
    }


def _accessor_bytes(file: GlbFile, index: int) -> bytes:
    return file.view(file.document["accessors"][index]["bufferView"])


def _floats(file: GlbFile, index: int, columns: int) -> NDArray[np.float32]:
    return np.frombuffer(_accessor_bytes(file, index), "<f4").astype(np.float32).reshape(-1, columns)
