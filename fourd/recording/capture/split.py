"""The file split.json of a capture, which names the cameras that training holds out by default."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.limits import read_json

NAME = "split.json"
VERSION = 1


def read_test_views(capture: Path) -> tuple[str, ...] | None:
    """Read the names of the held-out cameras from ``capture``/split.json. Returns None if the file does not exist.

    Raises:
        UserError: if the file is damaged, has unknown keys or has a newer version.
    """
    path = capture / NAME
    try:
        content = read_json(path)
        if content["version"] != VERSION:
            raise UserError(f"{path}: expected version {VERSION}, got {content['version']}; update fourd")
        names = content["test_views"]
        if set(content) != {"version", "test_views"} or not isinstance(names, list):
            raise ValueError
        if not all(isinstance(name, str) and name for name in names) or len(set(names)) != len(names):
            raise ValueError
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise UserError(
            f"{path}: expected the keys version and test_views, which is a list of different camera names, got other "
            "content; correct or delete the file"
        ) from error
    return tuple(names)


def write_test_views(capture: Path, names: Sequence[str]) -> None:
    """Write the names of the held-out cameras to ``capture``/split.json atomically."""
    write_text_atomically(capture / NAME, json.dumps({"version": VERSION, "test_views": list(names)}, indent=1) + "\n")


def require_known(capture: Path, test_views: Sequence[str], names: Sequence[str]) -> None:
    """Raise UserError if split.json names a camera that is not among ``names``, the cameras of the capture."""
    unknown = [name for name in test_views if name not in names]
    if unknown:
        raise UserError(
            f"{capture / NAME}: test_views: expected cameras among {', '.join(names)}, got '{unknown[0]}'; correct the "
            "name or remove it"
        )
