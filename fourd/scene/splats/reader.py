"""Reading of scenes from files of Gaussian splats or of coloured points, with one file for each frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from fourd.base.errors import UserError
from fourd.base.formats.frame_numbers import sort_sequence
from fourd.base.formats.ply import read_header, read_ply
from fourd.base.storage import Location
from fourd.scene.container import SceneReader
from fourd.scene.scene import BakedFrame
from fourd.scene.splats.cloud import SplatCloud
from fourd.scene.splats.dgs_reader import SUFFIX as DGS_SUFFIX
from fourd.scene.splats.dgs_reader import DgsReader
from fourd.scene.splats.frames import cloud_from_points, frame_from_splats
from fourd.scene.splats.ply import is_splat_ply, read_splat_ply
from fourd.scene.splats.raw import count_splats, read_splat
from fourd.scene.splats.splat_manifest import splat_manifest

SUFFIXES = (".ply", ".splat")
"""Suffixes of files with one frame."""


class SplatReader:
    """Reads splats as a scene without source views. Frames are not cached: each request reads the frame's file.

    The interface is that of :class:`fourd.scene.container.SceneReader`. The up direction is -y for splats, by
    convention, and +z for coloured points. ``manifest.points`` contains the numbers of splats in the files.

    Args:
        path: a `.ply` or `.splat` file, or a folder with one file for each frame.

    Raises:
        UserError: if there is no such file, or the header or size of a file is not valid.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        files = _list_files(self.path) if self.path.is_dir() else ([self.path], sort_sequence([self.path.stem])[1])
        self._files, numbers = files
        counts = tuple(_count(file) for file in self._files)
        up = np.array([0.0, -1.0, 0.0]) if _has_splats(self._files[0]) else np.array([0.0, 0.0, 1.0])
        producer = f"{self._files[0].suffix[1:]} file"
        self.manifest = splat_manifest(_read_cloud(self._files[0]), up, numbers, counts, producer)

    def close(self) -> None:
        """Do nothing: files are open only while they are read."""

    def read(self, index: int) -> BakedFrame:
        """Read the frame with the 0-based ``index``.

        Raises IndexError if there is no such frame, and UserError if its file is damaged.
        """
        if not 0 <= index < len(self._files):
            raise IndexError(f"frame: expected 0 to {len(self._files) - 1}, got {index}")
        return frame_from_splats(_read_cloud(self._files[index]))

    def read_dynamic(self, index: int) -> BakedFrame:
        """Read frame ``index``. There is no separate background."""
        return self.read(index)

    def read_background(self) -> None:
        """Return None, because splats have no separate background."""

    def read_shadow(self, index: int) -> None:
        """Return None, because splats have no shadows."""

    def read_sound(self) -> None:
        """Return None, because splats have no sound."""


Reader = SceneReader | SplatReader | DgsReader


def open_reader(path: Location) -> Reader:
    """Open a `.4dv` or its URL, a file of splats or points, or a folder of such files. Raises UserError."""
    if isinstance(path, Path) and is_splats(path):
        return DgsReader(path) if path.suffix.lower() == DGS_SUFFIX else SplatReader(path)
    return SceneReader(path)


def is_splats(path: Path) -> bool:
    """Return whether a path names a file of splats or points, or a folder that contains files with one frame each and
    is not a run."""
    if path.is_dir():
        return not (path / "config.yaml").exists() and bool(_list_files(path)[0])
    return path.suffix.lower() in (*SUFFIXES, DGS_SUFFIX)


def _list_files(folder: Path) -> tuple[list[Path], tuple[int, ...]]:
    """Return the splat files in a folder in the order of their frames, and their frame numbers."""
    files = [file for file in folder.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file()]
    order, numbers = sort_sequence([file.stem for file in files])
    return [files[index] for index in order], numbers


def _count(file: Path) -> int:
    return count_splats(file) if file.suffix.lower() == ".splat" else read_header(file).count


def _has_splats(file: Path) -> bool:
    return file.suffix.lower() == ".splat" or is_splat_ply(file)


def _read_cloud(file: Path) -> SplatCloud:
    if file.suffix.lower() == ".splat":
        cloud = read_splat(file)
    else:
        cloud = read_splat_ply(file) if is_splat_ply(file) else cloud_from_points(read_ply(file))
    if len(cloud) == 0:
        raise UserError(f"{file}: expected at least one splat with finite values, got none; write the file again")
    return cloud
