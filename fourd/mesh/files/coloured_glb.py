"""GLB files of meshes with colours at the vertices."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Array
from fourd.files import atomic_path
from fourd.formats.glb import ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, FLOAT, UINT32, pad, up_rotation, write_header
from fourd.mesh.files.glb import UNLIT

UINT16 = 5123
ASSET = {"version": "2.0", "generator": "fourd fit-triangles"}


def write_coloured_glb(
    path: Path,
    xyz: NDArray[np.float32],
    normals: NDArray[np.float32],
    rgb: NDArray[np.uint8],
    triangles: NDArray[np.integer],
    up: Array,
) -> None:
    """Write a mesh with colours at the vertices atomically. The material is unlit and visible from both sides.

    Args:
        path: the file.
        xyz: (N, 3) vertices in world coordinates.
        normals: (N, 3) unit normals.
        rgb: (N, 3) uint8 sRGB colours. The file has linear colours with 16 bits, as glTF demands.
        triangles: (M, 3) vertex indices.
        up: (3,) up direction of the scene in world coordinates, not zero.
    """
    colours = np.full((len(xyz), 4), 65535, "<u2")
    colours[:, :3] = np.rint(srgb_to_linear(rgb / 255.0) * 65535)
    parts = [
        np.ascontiguousarray(xyz, "<f4").tobytes(),
        np.ascontiguousarray(normals, "<f4").tobytes(),
        colours.tobytes(),
        np.ascontiguousarray(triangles, "<u4").tobytes(),
    ]
    document = _document(xyz, np.asarray(triangles).size, parts, up)
    binary = b"".join(pad(part, b"\0") for part in parts)
    with atomic_path(path) as temporary, temporary.open("wb") as stream:
        write_header(stream, document, len(binary), str(path))
        stream.write(binary)


def srgb_to_linear(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert sRGB colours in [0, 1] to linear colours in [0, 1] (IEC 61966-2-1)."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def _document(xyz: NDArray[np.float32], corners: int, parts: list[bytes], up: Array) -> dict[str, Any]:
    views: list[dict[str, Any]] = []
    offset = 0
    targets = (ARRAY_BUFFER, ARRAY_BUFFER, ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER)
    for part, target in zip(parts, targets, strict=True):
        views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(part), "target": target})
        offset += len(part) + -len(part) % 4
    count = len(xyz)
    limits = {"min": [float(v) for v in xyz.min(axis=0)], "max": [float(v) for v in xyz.max(axis=0)]}
    colour = {"componentType": UINT16, "normalized": True, "count": count, "type": "VEC4"}
    accessors: list[dict[str, Any]] = [
        {"bufferView": 0, "componentType": FLOAT, "count": count, "type": "VEC3"} | limits,
        {"bufferView": 1, "componentType": FLOAT, "count": count, "type": "VEC3"},
        {"bufferView": 2} | colour,
        {"bufferView": 3, "componentType": UINT32, "count": corners, "type": "SCALAR"},
    ]
    attributes = {"POSITION": 0, "NORMAL": 1, "COLOR_0": 2}
    surface = {"metallicFactor": 0, "roughnessFactor": 1}
    return {
        "asset": ASSET,
        "extensionsUsed": [UNLIT],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "world", "rotation": up_rotation(up), "children": [1]}, {"name": "frame", "mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 3, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": surface, "extensions": {UNLIT: {}}, "doubleSided": True}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": offset}],
    }
