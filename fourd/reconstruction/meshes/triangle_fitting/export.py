"""Writes coloured meshes as GLB and PLY files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from fourd.base.cameras import Array
from fourd.base.errors import UserError
from fourd.base.formats.glb_mesh import write_coloured_glb
from fourd.base.formats.ply import write_ply
from fourd.reconstruction.meshes.surface.losses import vertex_normals
from fourd.reconstruction.meshes.triangle_fitting.opaque import ColouredMesh

FORMATS = (".glb", ".ply")


def check_format(path: Path) -> None:
    """Raise a UserError if ``path`` does not end in .glb or .ply, or is a folder."""
    if path.suffix.lower() not in FORMATS:
        got = f"'{path.suffix}'" if path.suffix else "no suffix"
        raise UserError(f"{path}: expected a file name that ends in .glb or .ply, got {got}; choose another name")
    if path.is_dir():
        raise UserError(f"{path}: expected a file, got a folder; choose another name")


def write_mesh(path: Path, mesh: ColouredMesh, up: Array) -> None:
    """Write a mesh with vertex colours, atomically.

    Args:
        path: the file, in the format of its suffix (.glb or .ply).
        mesh: the mesh, with at least one triangle.
        up: (3,) nonzero up direction of the scene in world coordinates, which becomes +y in GLB files.
    """
    normals = vertex_normals(torch.from_numpy(mesh.xyz), torch.from_numpy(mesh.triangles).long()).numpy()
    normals = normals.astype(np.float32)
    if path.suffix.lower() == ".ply":
        write_ply(path, mesh.xyz, mesh.rgb, normals, mesh.triangles)
    else:
        write_coloured_glb(path, mesh.xyz, normals, mesh.rgb, mesh.triangles, up)
