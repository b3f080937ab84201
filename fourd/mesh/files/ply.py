"""PLY files of coloured triangle meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fourd.files import atomic_path

NAMES = ("x", "y", "z", "nx", "ny", "nz", "red", "green", "blue")


def write_mesh_ply(
    path: Path,
    xyz: NDArray[np.float32],
    normals: NDArray[np.float32],
    rgb: NDArray[np.uint8],
    triangles: NDArray[np.integer],
) -> None:
    """Write a triangle mesh as binary PLY in world coordinates, atomically.

    Args:
        path: the file.
        xyz: (N, 3) vertices.
        normals: (N, 3) unit normals.
        rgb: (N, 3) uint8 colours.
        triangles: (M, 3) vertex indices.
    """
    rows = np.empty(len(xyz), dtype=[(name, "<f4" if i < 6 else "u1") for i, name in enumerate(NAMES)])
    for i, name in enumerate(NAMES):
        rows[name] = (xyz, normals, rgb)[i // 3][:, i % 3]
    faces = np.empty(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    faces["count"], faces["corners"] = 3, triangles
    kinds = "\n".join(f"property {'float' if i < 6 else 'uchar'} {name}" for i, name in enumerate(NAMES))
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(xyz)}\n{kinds}\n"
        f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    with atomic_path(path) as temporary:
        temporary.write_bytes(header.encode("ascii") + rows.tobytes() + faces.tobytes())
