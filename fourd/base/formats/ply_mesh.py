"""Triangle meshes in PLY files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fourd.base.errors import UserError
from fourd.base.formats.mesh import Mesh
from fourd.base.formats.ply import read_faces, read_ply, read_vertices
from fourd.base.formats.ply_colours import find_colours

_NORMALS = ("nx", "ny", "nz")


def read_ply_mesh(path: Path) -> Mesh:
    """Read a mesh with vertex colours, and with normals if the file has them. The up direction is +z.

    Raises:
        UserError: if the file is missing or damaged, or its faces are not triangles.
    """
    triangles, points, rows = read_faces(path), read_ply(path), read_vertices(path)
    names = rows.dtype.names or ()
    has_normals = set(_NORMALS) <= set(names)
    has_colours = find_colours(path, frozenset(names)) is not None
    try:
        return Mesh(
            xyz=points.xyz,
            triangles=triangles,
            normals=np.stack([rows[name] for name in _NORMALS], 1).astype(np.float32) if has_normals else None,
            rgb=points.rgb if has_colours else None,
        )
    except ValueError as error:
        raise UserError(f"{path}: {error}; write the file again") from error
