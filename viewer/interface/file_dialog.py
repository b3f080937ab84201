"""The system's dialog for choosing a file or a folder. Without one, the user types the path."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any, Literal

_LINUX_PROGRAMS = ("zenity", "kdialog", "matedialog", "qarma")
"""Programs that show dialogs on Linux. Other systems have dialogs of their own."""


class FileDialog:
    """A dialog that runs beside the window."""

    def __init__(self, kind: Literal["file", "folder"]) -> None:
        from imgui_bundle import portable_file_dialogs

        self._dialog: Any
        if kind == "folder":
            self._dialog = portable_file_dialogs.select_folder("Open a run")
        else:
            filters = ["Scenes", "*.4dv *.4dgs *.ply *.splat *.spz *.sog *.gltf *.glb", "All files", "*"]
            self._dialog = portable_file_dialogs.open_file("Open a scene", "", filters)

    @property
    def is_done(self) -> bool:
        """Whether the user has chosen something or cancelled the dialog."""
        return bool(self._dialog.ready(0))

    def result(self) -> Path | None:
        """Return the chosen path, or None if the user has cancelled the dialog."""
        chosen = self._dialog.result()
        found = chosen if isinstance(chosen, str) else next(iter(chosen), "")
        return Path(found) if found else None


def has_file_dialogs() -> bool:
    """Return whether the system can show dialogs."""
    return not sys.platform.startswith("linux") or any(shutil.which(program) for program in _LINUX_PROGRAMS)
