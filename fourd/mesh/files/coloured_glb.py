"""GLB files of meshes with vertex colours."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fourd.cameras import Array
from fourd.formats.glb import (
    ARRAY_BUFFER,
    ELEMENT_ARRAY_BUFFER,
    UINT32,
    float_accessor,
    srgb_to_linear,
    up_rotation,
    write_parts,
)
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
    """Write a mesh with vertex colours and an unlit, double-sided material, atomically.

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
    parts = [
        np.ascontiguousarray(xyz, "<f4").tobytes(),
        np.ascontiguousarray(normals, "<f4").tobytes(),
        colours.tobytes(),
        np.ascontiguousarray(triangles, "<u4").tobytes(),
    ]
    document = _document(xyz, normals, np.asarray(triangles).size, up)
    write_parts(path, document, parts, (ARRAY_BUFFER, ARRAY_BUFFER, ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER))


def _document(xyz: NDArray[np.float32], normals: NDArray[np.float32], corners: int, up: Array) -> dict[str, Any]:
    colour = {"componentType": UINT16, "normalized": True, "count": len(xyz), "type": "VEC4"}
    accessors: list[dict[str, Any]] = [
        float_accessor(0, xyz, has_limits=True),
        float_accessor(1, normals),
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
    }
