"""Folders that ``fourd info`` describes by their parts: a web page, a work folder, and a folder with several things."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from fourd.base.files import list_folder
from fourd.cli.scenes.description.values import bytes_text
from fourd.reconstruction.training.run_layout import CONFIG_NAME

SITE_SCENE = "scene.4dv"
_SITE_FILES = ("index.html", SITE_SCENE, "player")
"""Names in the folder of a web page. They are those of :mod:`fourd.viewer.publish.site`, which imports more than the
description of a folder should wait for."""
_SIGNS = (CONFIG_NAME, "images", "videos", "intri.yml", "extri.yml")
"""Names in the folders of runs and captures."""
_MAX_PARTS = 24


def is_site(path: Path) -> bool:
    """Return whether a folder is a web page that ``fourd web`` has written."""
    return all((path / name).exists() for name in _SITE_FILES)


def is_work_folder(path: Path) -> bool:
    """Return whether a folder has the intermediate results of ``fourd make``."""
    return path.suffix == ".work" and (path / "run" / CONFIG_NAME).is_file()


def describe_parts(path: Path, describe: Callable[[Path], str | None]) -> list[tuple[str, str]]:
    """Return the names of the things in a folder that fourd knows, and what each is. ``describe`` returns None for
    others."""
    rows = []
    for name in list_folder(path):
        part = path / name
        known = None if name.startswith(".") or _has_unknown_content(part) else describe(part)
        if known is not None:
            size = folder_bytes(part) if part.is_dir() else part.stat().st_size
            rows.append((name, f"{known}, {bytes_text(size)}"))
    more = len(rows) - _MAX_PARTS
    return rows[:_MAX_PARTS] + ([("more", f"{more} others")] if more > 0 else [])


def folder_bytes(path: Path) -> int:
    """Return the size of all files in a folder and its folders."""
    return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())


def _has_unknown_content(path: Path) -> bool:
    """Return whether a folder is neither a run, a capture, a web page nor a work folder. Such a folder is not described
    as a part of another one, so that not all folders of a disk are searched."""
    is_known = is_site(path) or is_work_folder(path) or any((path / sign).exists() for sign in _SIGNS)
    return path.is_dir() and not is_known
