"""Names of new files."""

from __future__ import annotations

from pathlib import Path


def unused_path(stem: str, suffix: str) -> Path:
    """Return the first path of the series STEM-001SUFFIX, STEM-002SUFFIX, ... that does not exist in the working
    directory."""
    number = 1
    while (path := Path(f"{stem}-{number:03d}{suffix}")).exists():
        number += 1
    return path
