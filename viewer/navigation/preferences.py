"""Stores the scenes that were opened last, and the theme, in the user's state folder."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

from fourd.base.files import write_text_atomically
from fourd.base.json_file import decode_json
from fourd.base.limits import read_json

MAX_RECENT = 8
"""Number of scenes that are remembered."""


@dataclass(frozen=True)
class Preferences:
    """What the viewer remembers from one start to the next.

    Attributes:
        theme: colours of the user interface.
        recent: absolute paths of the scenes that were opened last, the newest first.
    """

    theme: Literal["dark", "light"] = "dark"
    recent: tuple[str, ...] = ()

    def with_recent(self, path: Path) -> Preferences:
        """Return the preferences after ``path`` was opened."""
        opened = str(path.resolve())
        others = [other for other in self.recent if other != opened]
        return replace(self, recent=(opened, *others)[:MAX_RECENT])


class PreferencesFile:
    """Reads and writes the preferences. A file that cannot be read counts as empty. If the file cannot be written, the
    old one stays unchanged."""

    def __init__(self, file: Path) -> None:
        self._file = file

    def load(self) -> Preferences:
        """Return the stored preferences."""
        try:
            return decode_json(read_json(self._file), Preferences)
        except (OSError, ValueError):
            return Preferences()

    def save(self, preferences: Preferences) -> None:
        """Store the preferences."""
        try:
            write_text_atomically(self._file, json.dumps(asdict(preferences)))
        except OSError:
            return
