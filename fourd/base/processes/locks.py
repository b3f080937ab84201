"""Locks on folders. A lock ensures that only one command at a time changes a run, a capture or a work folder, because
two commands could delete each other's files.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from fourd.base.errors import UserError
from fourd.base.limits import printable

if sys.platform != "win32":
    import fcntl

MAX_COMMAND = 80
"""Maximum number of characters of a command line that an error message quotes."""
IN_USE = (errno.EWOULDBLOCK, errno.EACCES)


@contextmanager
def locked_file(path: Path) -> Iterator[None]:
    """Wait for the lock on the file ``path``, and hold it while the ``with`` block runs. A missing file is created.

    On Windows, and on file systems without flock, nothing is locked.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as stream:
        if sys.platform != "win32":
            with contextlib.suppress(OSError):
                fcntl.flock(stream.fileno(), fcntl.LOCK_EX)
        yield


@contextmanager
def locked_folder(folder: Path) -> Iterator[None]:
    """Lock ``folder`` for this process while the ``with`` block runs. A missing folder is created.

    The lock is an flock on the folder itself, so no lock file is needed. The system releases it when the process ends,
    even if the process is killed. If this function has created the folder and it is still empty after the block, it is
    removed. On Windows, and on file systems without flock, nothing is locked.

    Raises:
        UserError: if another process holds the lock. The message names the process and its start time.
    """
    if sys.platform == "win32":
        yield
        return
    is_new = not folder.exists()
    descriptor = _lock(folder)
    try:
        yield
    finally:
        if is_new:
            with contextlib.suppress(OSError):
                folder.rmdir()
        os.close(descriptor)


def _lock(folder: Path) -> int:
    """Lock the folder and return its descriptor."""
    while True:
        if folder.exists() and not folder.is_dir():
            raise UserError(f"{folder}: expected a folder, got a file; name another folder")
        folder.mkdir(parents=True, exist_ok=True)
        try:
            descriptor = os.open(folder, os.O_RDONLY)
        except FileNotFoundError:
            continue  # another process has removed the folder since mkdir, when it released its lock
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = _describe_holder(descriptor)
            if error.errno in IN_USE:
                os.close(descriptor)
                raise UserError(
                    f"{folder}: expected a folder that no other command changes, got one that is in use by {holder}; "
                    "wait until that command has ended"
                ) from error
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.stat(folder), os.fstat(descriptor)):
                return descriptor
        os.close(descriptor)


def _describe_holder(descriptor: int) -> str:
    """Describe the process that holds the lock. On Linux, its ID is read from /proc/locks. On other systems, the
    description is only "another process"."""
    try:
        inode = os.fstat(descriptor).st_ino
        lines = [line.split() for line in Path("/proc/locks").read_text(encoding="ascii").splitlines()]
        process = next(
            int(words[4]) for words in lines if words[1] == "FLOCK" and words[5].rpartition(":")[2] == str(inode)
        )
        since = datetime.fromtimestamp(os.stat(f"/proc/{process}").st_ctime).strftime("%Y-%m-%d %H:%M:%S")
        words = Path(f"/proc/{process}/cmdline").read_bytes().split(b"\0")
        command = printable(" ".join(os.fsdecode(word) for word in words[1:4]).strip())[:MAX_COMMAND]
    except (OSError, ValueError, IndexError, StopIteration):
        return "another process"
    return f"process {process} ({command}), which started at {since}"
