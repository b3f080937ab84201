"""The two kinds of sequences that can be imported: a `.4dv` file, and a folder of PLY files."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from fourd.viewer.blender.addon.manifest import Manifest, read_manifest
from fourd.viewer.blender.addon.ply_files import list_sequence, read_ply
from fourd.viewer.blender.addon.points import Cloud, ImportProblem
from fourd.viewer.blender.addon.scene_file import read_frame


@dataclass(frozen=True, eq=False)
class Sequence:
    """An open sequence. Frames are read when they are shown, and not kept.

    Attributes:
        manifest: the manifest of a `.4dv` file, or None.
        files: the PLY files, or an empty tuple.
    """

    manifest: Manifest | None
    files: tuple[Path, ...] = ()

    @property
    def frame_count(self) -> int:
        return len(self.files) if self.manifest is None else len(self.manifest.points)

    def read(self, frame: int) -> Cloud:
        """Read the frame with the 0-based index ``frame``. Raises ImportProblem."""
        return read_ply(self.files[frame]) if self.manifest is None else read_frame(self.manifest, frame)


def open_sequence(path: Path) -> Sequence:
    """Open a `.4dv` file, or the sequence to which a PLY file belongs. Raises ImportProblem."""
    try:
        status = path.stat()
    except (OSError, ValueError) as error:
        raise ImportProblem(f"{path}: expected a .4dv or .ply file, got none; choose another file") from error
    return _open(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=8)
def _open(path: Path, modified_ns: int, size: int) -> Sequence:
    """Open a file that has not changed since the last call only once: the manifest of a long scene is large."""
    if path.suffix.lower() == ".ply" or path.is_dir():
        return Sequence(None, tuple(list_sequence(path)))
    return Sequence(read_manifest(path))
