"""Scratch folders. Each command that uses a run has its own scratch folder, so that train, eval, render, export and
view can use the run at the same time."""

from __future__ import annotations

import contextlib
import os
import secrets
import shutil
import sys
import weakref
from pathlib import Path
from typing import BinaryIO

if sys.platform != "win32":
    import fcntl

LOCK_SUFFIX = ".lock"
"""Suffix of lock files. A process keeps the file NAME.lock locked while it uses the scratch folder NAME."""


class Scratch:
    """A new folder in ``parent`` that no other process and no other Scratch object uses.

    The folder is removed when this object is deleted or the process exits. If the process is killed, the folder remains
    until the next Scratch with the same ``parent`` is created.
    """

    def __init__(self, parent: Path) -> None:
        _remove_leftovers(parent)
        name, lock = _create_lock(parent)
        self.folder = parent / name
        self.folder.mkdir()
        self._remove = weakref.finalize(self, _remove, self.folder, lock)

    def close(self) -> None:
        """Remove the folder. Further calls do nothing."""
        self._remove()


def _create_lock(parent: Path) -> tuple[str, BinaryIO]:
    """Choose a new folder name, then create and lock the folder's lock file in ``parent``. The folder ``parent`` is
    created if necessary."""
    while True:
        name = f"{os.getpid()}-{secrets.token_hex(4)}"
        path = parent / f"{name}{LOCK_SUFFIX}"
        parent.mkdir(parents=True, exist_ok=True)
        try:
            stream = path.open("xb")
        except FileNotFoundError:
            continue  # Another process has removed ``parent``, which was empty.
        # Before this process locked the new file, another process may have removed it, because an unlocked lock file
        # looks like a leftover of a process that has ended.
        if _try_lock(stream) and path.exists():
            return name, stream
        stream.close()


def _remove(folder: Path, lock: BinaryIO) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    if sys.platform == "win32":
        lock.close()  # On Windows, open files cannot be removed.
    if folder.exists():  # The next Scratch with this parent removes the folder, because the lock file remains.
        lock.close()
        return
    with contextlib.suppress(OSError):
        folder.with_name(f"{folder.name}{LOCK_SUFFIX}").unlink(missing_ok=True)
    lock.close()
    with contextlib.suppress(OSError):
        folder.parent.rmdir()  # rmdir succeeds only if there is no other scratch folder


def _remove_leftovers(parent: Path) -> None:
    """Remove the scratch folders of processes that have ended, which are those whose lock files are not locked."""
    for path in parent.glob(f"*{LOCK_SUFFIX}"):
        with contextlib.suppress(OSError), path.open("rb+") as stream:
            if _try_lock(stream):
                shutil.rmtree(path.with_suffix(""), ignore_errors=True)
                if not path.with_suffix("").exists():
                    path.unlink(missing_ok=True)


def _try_lock(stream: BinaryIO) -> bool:
    """Lock an open file until it is closed. Returns False if another process or object holds the lock."""
    if sys.platform == "win32":
        import msvcrt

        try:
            msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        return True
    try:
        fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True
