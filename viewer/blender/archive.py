"""Writes the add-on as a ZIP file. Equal sources give equal bytes."""

from __future__ import annotations

import re
import zipfile
from importlib.resources import as_file, files
from pathlib import Path

from fourd.base.files import atomic_path

NAME = "fourd_scenes"
"""Name of the add-on's folder, by which Blender identifies it."""
_OWN_IMPORT = re.compile(r"^(\s*)from fourd\.viewer\.blender\.addon(\.\w+)? import ", re.MULTILINE)
_TIME = (1980, 1, 1, 0, 0, 0)


def write_addon(out: Path) -> None:
    """Write the add-on to ``out`` atomically. Raises OSError.

    The modules import each other by their names in fourd. In Blender, the folder has another name, so that these
    imports become relative.
    """
    with (
        as_file(files("fourd.viewer.blender") / "addon") as folder,
        atomic_path(out) as temporary,
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive,
    ):
        for path in sorted([*folder.glob("*.py"), *folder.glob("*.toml")]):
            text = _OWN_IMPORT.sub(_relative, path.read_text(encoding="utf-8"))
            archive.writestr(zipfile.ZipInfo(f"{NAME}/{path.name}", _TIME), text)


def _relative(match: re.Match[str]) -> str:
    return f"{match[1]}from .{(match[2] or '').removeprefix('.')} import "
