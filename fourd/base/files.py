"""Atomic writing of files, and the order of file names.

At any time, a file that is written atomically has either its old content or its complete new content."""

from __future__ import annotations

import glob
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path, PurePath

from fourd.base.errors import UserError
from fourd.base.limits import require_regular

if sys.platform != "win32":
    import fcntl

UNFINISHED = ".unfinished-"
"""Prefix of the names of temporary files."""


def natural_key(name: str) -> tuple[tuple[str | int, ...], str]:
    """Sort key of file names that compares the numbers in names by value, so that frame_2 comes before frame_10."""
    parts = re.split(r"(\d+)", name)
    return tuple(int(part) if index % 2 else part for index, part in enumerate(parts)), name


def sort_names(names: Iterable[str]) -> list[str]:
    """Sort file names by :func:`natural_key`. All lists of files with one file per frame or camera have this order."""
    return sorted(names, key=natural_key)


def list_folder(folder: Path | str) -> list[str]:
    """Return the names in a folder in the order of :func:`sort_names`, without hidden files.

    Raises:
        OSError: if the folder cannot be read.
    """
    return sort_names(name for name in os.listdir(folder) if not name.startswith("."))


@contextmanager
def atomic_path(target: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside ``target``, and rename the temporary file to ``target`` if the ``with`` block
    succeeds.

    If ``target`` is a named pipe, a socket or a device, UserError is raised, because the renamed file would replace it.

    Use this context manager with file writers that take a path. The temporary file has the suffix of ``target``,
    because some writers choose the file format by the suffix. It is synced to disk before it is renamed. If the
    ``with`` block raises an exception, the temporary file is removed, and ``target`` is unchanged. If the process is
    killed, the temporary file remains until :func:`remove_unfinished` removes it.
    """
    target = Path(target)
    require_regular(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    descriptor, name = _create_temporary(target)
    temporary = Path(name)
    if sys.platform == "win32":
        os.close(descriptor)
    try:
        yield temporary
        _fsync(temporary)
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        os.replace(temporary, target)
        _fsync(target.parent)
    except OSError as error:
        if error.filename not in (None, name) or error.errno is None:
            raise
        # The message names the target, because the name of the temporary file means nothing to the user.
        raise OSError(error.errno, error.strerror, str(target)) from error
    finally:
        try:
            temporary.unlink(missing_ok=True)
        finally:
            if sys.platform != "win32":
                os.close(descriptor)


@contextmanager
def atomic_folder(target: Path) -> Iterator[Path]:
    """Yield a temporary folder beside ``target``, which replaces the folder ``target`` if the ``with`` block succeeds.

    If the ``with`` block raises an exception, the temporary folder is removed and ``target`` is unchanged. If the block
    succeeds, an existing ``target`` is renamed, then the temporary folder is renamed to ``target``, and finally the old
    folder is removed. ``target`` is therefore missing only for a moment, between the two renames.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = Path(tempfile.mkdtemp(dir=target.parent, prefix=f"{UNFINISHED}{target.name}-"))
    old = temporary.with_name(f"{temporary.name}-old")
    try:
        yield temporary
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o777 & ~umask)
        for path in temporary.rglob("*"):
            if path.is_file() and not path.is_symlink():
                _fsync(path)
        if target.exists():
            os.replace(target, old)
        os.replace(temporary, target)
        _fsync(target.parent)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


def write_bytes_atomically(target: Path | str, content: bytes) -> None:
    """Write ``content`` to ``target`` in one indivisible step (see :func:`atomic_path`)."""
    with atomic_path(target) as temporary:
        temporary.write_bytes(content)


def write_text_atomically(target: Path | str, content: str) -> None:
    """Write UTF-8 text to ``target`` in one indivisible step (see :func:`atomic_path`)."""
    write_bytes_atomically(target, content.encode("utf-8"))


def remove_unfinished(folder: Path | str, *, deep: bool = False) -> None:
    """Remove the temporary files that remain in ``folder`` and, if ``deep``, in its subfolders after a process was
    killed.

    Do not call this function while another process writes to ``folder``, because it also removes temporary files that
    are in use.
    """
    for path in list(Path(folder).glob(f"{'**/' if deep else ''}{UNFINISHED}*")):
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink(missing_ok=True)


def remove_unfinished_file(target: Path | str) -> None:
    """Remove the temporary files for ``target`` that remain after a process was killed.

    Temporary files of running processes are kept; they are recognised by their locks.
    """
    target = Path(target)
    stem, suffix = glob.escape(target.stem), glob.escape(target.suffix)
    # A temporary file can itself be written atomically, which needs another temporary file. The second pattern finds
    # this other file.
    patterns = (f"{UNFINISHED}{stem}-????????{suffix}", f"{UNFINISHED}{UNFINISHED}{stem}-????????-????????{suffix}")
    for path in [path for pattern in patterns for path in target.parent.glob(pattern)]:
        try:
            descriptor = os.open(path, os.O_RDONLY)
        except OSError:
            continue
        try:
            if try_lock(descriptor) is not False:
                path.unlink(missing_ok=True)
        finally:
            os.close(descriptor)


def remove_unfinished_folder(target: Path) -> None:
    """Remove the temporary folders for ``target`` that remain after a process was killed.

    If a process was killed while it replaced ``target``, the old content is restored. Call this function only while
    ``target`` is locked.
    """
    pattern = f"{UNFINISHED}{glob.escape(target.name)}-????????"
    for old in sorted(target.parent.glob(f"{pattern}-old")):
        if not target.exists() or (target.is_dir() and not any(target.iterdir())):
            os.replace(old, target)
        else:
            shutil.rmtree(old, ignore_errors=True)
    for path in target.parent.glob(pattern):
        shutil.rmtree(path, ignore_errors=True)


def resolved(path: Path | str) -> Path:
    """Return the absolute path without symbolic links. The file may be missing.

    Links that form a loop are kept. (Before Python 3.13, Path.resolve raises RuntimeError for them.)
    """
    return Path(os.path.realpath(path))


def require_suffix(target: object, suffixes: tuple[str, ...], what: str) -> None:
    """Raise UserError unless the name of an output ends in one of ``suffixes``, in upper or lower case.

    Args:
        target: a path or a URL.
        suffixes: the suffixes, in lower case.
        what: names the output in the message, for example "a scene".
    """
    name = PurePath(str(target))
    if name.suffix.lower() not in suffixes:
        listed = " or ".join(suffixes)
        got = f"the suffix {name.suffix}" if name.suffix else "no suffix"
        example = PurePath(name.stem or "file").with_suffix(suffixes[0])
        raise UserError(f"{target}: expected a name that ends in {listed} for {what}, got {got}; write {example}")


def is_unused(folder: Path | str) -> bool:
    """Return True if a folder is missing, or contains no files except temporary files of killed processes."""
    folder = Path(folder)
    if not folder.is_dir():
        return not folder.exists()
    return all(
        path.name.startswith(UNFINISHED) or (path.is_dir() and not path.is_symlink()) for path in folder.rglob("*")
    )


def _create_temporary(target: Path) -> tuple[int, str]:
    """Create a temporary file beside ``target``, and lock it. Returns its open descriptor and its path."""
    while True:
        descriptor, name = tempfile.mkstemp(
            dir=target.parent, prefix=f"{UNFINISHED}{target.stem}-", suffix=target.suffix
        )
        # Until the file is locked, another process may remove it as a leftover of a killed process. If that has
        # happened, another file is created.
        if try_lock(descriptor) is not False and os.path.exists(name):
            return descriptor, name
        os.close(descriptor)


def try_lock(descriptor: int) -> bool | None:
    """Lock an open file or folder until its descriptor is closed, and return True. Returns False if another process
    holds a lock.

    Returns None, without locking, on file systems without locks and on Windows. (A locked file must stay open, but
    Windows cannot rename open files.)
    """
    if sys.platform == "win32":
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _fsync(path: Path) -> None:
    """Flush a file's content, or a folder's list of entries, to the disk. Does nothing for a folder on Windows."""
    if sys.platform == "win32" and path.is_dir():
        return
    descriptor = os.open(path, os.O_RDWR if sys.platform == "win32" else os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
