"""Files of triangle meshes: one mesh, or a folder with one mesh for each frame."""

from __future__ import annotations

from pathlib import Path

from fourd.base.errors import UserError
from fourd.base.formats.frame_numbers import sort_sequence
from fourd.base.formats.glb_mesh import read_glb_mesh
from fourd.base.formats.mesh import Mesh
from fourd.base.formats.ply import read_header
from fourd.base.formats.ply_mesh import read_ply_mesh

ANIMATION_NAME = "animation.glb"
"""Name of the file that contains all frames as an animation. `fourd mesh` writes it beside the files of the single
frames."""


def is_mesh(path: Path) -> bool:
    """Return whether a path names a GLB file, a PLY file with triangles, or a folder that contains such files and is
    not a run.

    Raises UserError if a PLY file has no valid header.
    """
    if path.is_dir():
        return not (path / "config.yaml").exists() and any(is_mesh(file) for file in _list_files(path)[:1])
    if path.suffix.lower() == ".glb":
        return True
    return path.suffix.lower() == ".ply" and path.is_file() and read_header(path).faces is not None


class MeshSource:
    """Reads the meshes of frames. Each call reads the requested frame from its file.

    Args:
        path: a file, or a folder with one file for each frame.

    Attributes:
        frame_numbers: for each frame, its number, taken from the name of its file.
    """

    def __init__(self, path: Path) -> None:
        self._files = _list_files(path) if path.is_dir() else [path]
        self.frame_numbers = sort_sequence([file.stem for file in self._files])[1]

    def read(self, index: int) -> Mesh:
        """Read the frame with the 0-based ``index``. Raises UserError if the frame's file is not a valid mesh."""
        file = self._files[index]
        if file.suffix.lower() == ".ply" and read_header(file).faces is None:
            raise UserError(f"{file}: expected a mesh as in the other files, got points; remove the file")
        return read_ply_mesh(file) if file.suffix.lower() == ".ply" else read_glb_mesh(file)


def _list_files(folder: Path) -> list[Path]:
    """Return a folder's mesh files in the order of their frames: the GLB files, or the PLY files if there are none."""
    files = [file for file in folder.iterdir() if file.is_file() and file.name != ANIMATION_NAME]
    for suffix in (".glb", ".ply"):
        found = [file for file in files if file.suffix.lower() == suffix]
        if found:
            return [found[index] for index in sort_sequence([file.stem for file in found])[0]]
    return []
