"""Triangle meshes in GLB files, with a texture or with vertex colours.

The vertices in a file are in world coordinates. glTF requires metres, right-handed axes and +y as the up axis, so the
root node rotates the scene's up direction to +y. Textures are embedded JPEG images. The material is unlit
(KHR_materials_unlit), because the colours already contain the scene's lighting.

The reader accepts only the structure that the writers give a file.
"""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL.JpegImagePlugin import JpegImageFile
from PIL.PngImagePlugin import PngImageFile

from fourd.base.cameras import Array
from fourd.base.formats.glb import (
    ARRAY_BUFFER,
    ELEMENT_ARRAY_BUFFER,
    UINT16,
    UINT32,
    GlbFile,
    float_accessor,
    name_errors,
    read_glb,
    srgb_to_linear,
    up_rotation,
    whole,
    write_parts,
)
from fourd.base.formats.mesh import Mesh

LINEAR, LINEAR_MIPMAP_LINEAR, CLAMP_TO_EDGE = 9729, 9987, 33071
JPEG_QUALITY = 95
UNLIT = "KHR_materials_unlit"
MAX_TEXTURE_SIDE = 1 << 13
"""Largest side of a texture that :func:`read_glb_mesh` accepts by default."""


def write_textured_glb(
    path: Path,
    xyz: NDArray[np.float32],
    normals: NDArray[np.float32],
    uv: NDArray[np.float32],
    texture: NDArray[np.uint8],
    triangles: NDArray[np.integer],
    up: Array,
) -> None:
    """Write a mesh with a texture, atomically.

    Args:
        path: the file.
        xyz: (N, 3) vertices in world coordinates.
        normals: (N, 3) unit normals.
        uv: (N, 2) texture coordinates from 0 to 1. (0, 0) is the upper left corner of the texture.
        texture: (S, S, 3) uint8 sRGB texture.
        triangles: (M, 3) vertex indices.
        up: (3,) nonzero up direction of the scene in world coordinates.
    """
    parts = [np.ascontiguousarray(uv, "<f4").tobytes(), encode_texture(texture)]
    look = {
        "materials": [textured_material(0)],
        "textures": [{"source": 0, "sampler": 0}],
        "samplers": [sampler()],
        "images": [{"bufferView": 4, "mimeType": "image/jpeg"}],
    }
    _write(path, (xyz, normals, triangles), up, ("TEXCOORD_0", float_accessor(2, uv)), parts, look, "fourd mesh")


def write_coloured_glb(
    path: Path,
    xyz: NDArray[np.float32],
    normals: NDArray[np.float32],
    rgb: NDArray[np.uint8],
    triangles: NDArray[np.integer],
    up: Array,
) -> None:
    """Write a mesh with vertex colours and a double-sided material, atomically.

    Args:
        path: the file.
        xyz: (N, 3) vertices in world coordinates.
        normals: (N, 3) unit normals.
        rgb: (N, 3) uint8 sRGB colours. The file stores linear colours with 16 bits per channel, as glTF requires.
        triangles: (M, 3) vertex indices.
        up: (3,) nonzero up direction of the scene in world coordinates.
    """
    colours = np.full((len(xyz), 4), 65535, "<u2")
    colours[:, :3] = np.rint(srgb_to_linear(rgb / 255.0) * 65535)
    accessor = {"bufferView": 2, "componentType": UINT16, "normalized": True, "count": len(xyz), "type": "VEC4"}
    surface = {"metallicFactor": 0, "roughnessFactor": 1}
    look = {"materials": [{"pbrMetallicRoughness": surface, "extensions": {UNLIT: {}}, "doubleSided": True}]}
    generator = "fourd fit-triangles"
    _write(path, (xyz, normals, triangles), up, ("COLOR_0", accessor), [colours.tobytes()], look, generator)


def _write(
    path: Path,
    shape: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.integer]],
    up: Array,
    attribute: tuple[str, dict[str, Any]],
    parts: list[bytes],
    look: dict[str, Any],
    generator: str,
) -> None:
    """Write a mesh, atomically.

    Args:
        path: the file.
        shape: vertices, normals and triangles.
        up: the up direction.
        attribute: name and accessor of the third vertex attribute.
        parts: the bytes of this attribute, and of an image if there is one.
        look: the material, and the texture if there is one.
        generator: name of the program.
    """
    xyz, normals, triangles = shape
    positions, directions = (np.ascontiguousarray(array, "<f4").tobytes() for array in (xyz, normals))
    indices = np.ascontiguousarray(triangles, "<u4").tobytes()
    name, accessor = attribute
    attributes = {"POSITION": 0, "NORMAL": 1, name: 2}
    document = {
        "asset": {"version": "2.0", "generator": generator},
        "extensionsUsed": [UNLIT],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "world", "rotation": up_rotation(up), "children": [1]}, {"name": "frame", "mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 3, "material": 0}]}],
        **look,
        "accessors": [
            float_accessor(0, xyz, has_limits=True),
            float_accessor(1, normals),
            accessor,
            {"bufferView": 3, "componentType": UINT32, "count": np.asarray(triangles).size, "type": "SCALAR"},
        ],
    }
    targets = (ARRAY_BUFFER, ARRAY_BUFFER, ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, None)
    content = [positions, directions, parts[0], indices, *parts[1:]]
    write_parts(path, document, content, targets[: len(content)])


def textured_material(texture: int) -> dict[str, Any]:
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


def encode_texture(texture: NDArray[np.uint8]) -> bytes:
    """Encode an RGB texture (S, S, 3) as JPEG without chroma subsampling."""
    flags = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY, cv2.IMWRITE_JPEG_SAMPLING_FACTOR]
    ok, code = cv2.imencode(".jpg", texture[..., ::-1], [*flags, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444])
    if not ok:
        raise RuntimeError("OpenCV could not encode the texture as JPEG")
    return code.tobytes()


def read_glb_mesh(path: Path, max_texture_side: int = MAX_TEXTURE_SIDE) -> Mesh:
    """Read a mesh in the world coordinates of its capture.

    Args:
        path: a file with one mesh in the form that :func:`write_textured_glb` and :func:`write_coloured_glb` write.
        max_texture_side: largest width and height of the texture in texels.

    Raises:
        UserError: if the file is missing or damaged, or its content has another form.
    """
    with name_errors(path):
        return _mesh(read_glb(path), max_texture_side)


def _mesh(file: GlbFile, max_texture_side: int) -> Mesh:
    document = file.document
    meshes = document["meshes"]
    if len(meshes) != 1 or len(meshes[0]["primitives"]) != 1:
        raise ValueError(f"expected one mesh, got {len(meshes)} meshes, as in an animation; name the folder of frames")
    primitive = meshes[0]["primitives"][0]
    if primitive.get("mode", 4) != 4:
        raise ValueError("expected triangles, got points or lines")
    attributes = primitive["attributes"]
    indices = file.array(primitive["indices"], 1)
    if len(indices) % 3 or indices.dtype.kind != "u":
        raise ValueError(f"expected three indices for each triangle, got {len(indices)} indices")
    normals = attributes.get("NORMAL")
    texture = _texture(file, max_texture_side) if "TEXCOORD_0" in attributes and document.get("images") else None
    return Mesh(
        xyz=file.array(attributes["POSITION"], 3).astype(np.float32),
        triangles=indices.astype(np.int64).clip(0, 2**31 - 1).astype(np.int32).reshape(-1, 3),
        normals=None if normals is None else file.array(normals, 3).astype(np.float32),
        rgb=_colours(file.array(attributes["COLOR_0"], 3)) if "COLOR_0" in attributes else None,
        uv=None if texture is None else file.array(attributes["TEXCOORD_0"], 2).astype(np.float32),
        texture=texture,
        up=_up(document),
    )


def _texture(file: GlbFile, max_side: int) -> NDArray[np.uint8]:
    content = file.view(file.document["images"][0]["bufferView"])
    # Pillow's Image.open refuses images with fewer pixels than the largest texture of fourd mesh. For this reason, the
    # size is checked here, before the image is decoded, because a small file can declare a huge image.
    decoder = PngImageFile if content.startswith(b"\x89PNG") else JpegImageFile
    damaged = "expected a JPEG or PNG as texture, got a damaged image or another file"
    try:
        image = decoder(io.BytesIO(content))
    except (OSError, SyntaxError, ValueError, KeyError, IndexError, TypeError, struct.error) as error:
        raise ValueError(damaged) from error
    if max(image.size) > max_side:
        got = f"{image.size[0]} x {image.size[1]}"
        raise ValueError(f"expected a texture of at most {max_side} texels per side, got {got}")
    try:
        return np.asarray(image.convert("RGB"))
    except (OSError, SyntaxError) as error:
        raise ValueError(damaged) from error


def _colours(linear: NDArray[Any]) -> NDArray[np.uint8]:
    """Convert linear vertex colours in [0, 1] to sRGB bytes (IEC 61966-2-1)."""
    values = np.clip(linear.astype(np.float64), 0, 1)
    srgb = np.where(values <= 0.0031308, 12.92 * values, 1.055 * values ** (1 / 2.4) - 0.055)
    return np.rint(255 * srgb).astype(np.uint8)


def _up(document: dict[str, Any]) -> NDArray[np.float64]:
    """Return the direction, in vertex coordinates, that the root node rotates to +y."""
    root = document["nodes"][whole(document["scenes"][0]["nodes"][0])]
    for node in document["nodes"]:
        if {"matrix", "scale", "translation"} & set(node):
            raise ValueError("expected nodes that only rotate, as fourd writes them, got another transform")
    x, y, z, w = (float(value) for value in root.get("rotation", (0, 0, 0, 1)))
    if not abs(x * x + y * y + z * z + w * w - 1) < 1e-3:
        raise ValueError("expected a unit quaternion as rotation of the root node, got another length")
    up = np.array([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)])
    return np.asarray(up / np.linalg.norm(up))
