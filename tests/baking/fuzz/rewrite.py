"""Makes copies of scenes with changed members."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path


def rewrite_members(source: Path, target: Path, change: Callable[[dict[str, bytes]], None]) -> None:
    """Copy a scene. ``change`` receives a dictionary with the content of each member by name, and changes the
    dictionary.
    """
    with zipfile.ZipFile(source) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    change(members)
    with zipfile.ZipFile(target, "w", zipfile.ZIP_STORED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
