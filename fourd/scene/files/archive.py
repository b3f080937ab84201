"""The ZIP archive of a `.4dv`: checks of its members, and error messages that say what the user can do.

The archive itself is uncompressed; members of packed scenes are compressed before they are stored. The archive is
untrusted input.
"""

from __future__ import annotations

import errno
import os
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fourd.base.errors import UserError
from fourd.base.limits import require_regular
from fourd.base.storage import Location, StorageUrl, open_object

_TIMESTAMP = (1980, 1, 1, 0, 0, 0)
_ENCRYPTED = 0x1
ZIP_ERRORS = (
    zipfile.BadZipFile,
    zipfile.LargeZipFile,
    struct.error,
    zlib.error,
    EOFError,
    NotImplementedError,
    RuntimeError,
    ValueError,
    OverflowError,
)


def make_member(name: str) -> zipfile.ZipInfo:
    """Return the ZIP entry of a member. All entries have the same constant modification time, so that equal contents
    give equal archives."""
    info = zipfile.ZipInfo(name, _TIMESTAMP)
    info.external_attr = 0o644 << 16
    return info


def open_zip(path: Location) -> zipfile.ZipFile:
    """Open an archive for reading. The archive is read with range requests if it is an object in an object store.
    Raises UserError."""
    if isinstance(path, Path) and path.is_dir():
        raise UserError(f"{path}: expected a .4dv file, got a folder; name the file that fourd export wrote")
    try:
        if isinstance(path, StorageUrl):
            return zipfile.ZipFile(open_object(path))
        require_regular(path)
        return zipfile.ZipFile(path)
    except FileNotFoundError as error:
        raise UserError(f"{path}: expected a .4dv file, got a path that does not exist; check the path") from error
    except ZIP_ERRORS as error:
        raise UserError(
            f"{path}: expected a complete .4dv scene (a ZIP), got a truncated file or another kind of file; "
            "copy or export it again"
        ) from error
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error}); check its permissions") from error


def archive_size(archive: zipfile.ZipFile) -> int:
    """Return the file size, in bytes, of an open archive."""
    assert archive.fp is not None
    return archive.fp.seek(0, os.SEEK_END)


def check_members(path: Location, archive: zipfile.ZipFile) -> dict[str, zipfile.ZipInfo]:
    """Check the members' names and sizes, and that the members are neither compressed nor encrypted. Returns their ZIP
    entries by name. Raises UserError if a member fails the check."""
    members: dict[str, zipfile.ZipInfo] = {}
    size, total = archive_size(archive), 0
    for info in archive.infolist():
        name = info.filename
        if name.startswith("/") or "\\" in name or ":" in name or ".." in name.split("/"):
            raise damaged(path, "member names inside the archive", repr(name[:80]))
        if name in members:
            raise damaged(path, "every member once", f"{name!r} twice")
        if info.flag_bits & _ENCRYPTED:
            raise UserError(
                f"{path}: expected unencrypted members, got the encrypted member {name!r}; export the scene again"
            )
        if info.compress_type != zipfile.ZIP_STORED or info.compress_size != info.file_size:
            raise UserError(
                f"{path}: expected uncompressed members, got the compressed member {name!r}; use zip -0 or export again"
            )
        if not 0 <= info.header_offset < size:
            raise damaged(path, "members inside the file", f"{name!r} at byte {info.header_offset}")
        total += info.file_size
        members[name] = info
    if total > size:
        raise damaged(path, f"members of at most {size} bytes, the file's size", f"{total}")
    return members


def find_damaged_member(path: Location) -> str | None:
    """Return the name of the first member whose bytes do not match their CRC-32, or None. Raises UserError."""
    with open_zip(path) as archive:
        check_members(path, archive)
        try:
            return archive.testzip()
        except ZIP_ERRORS as error:
            raise damaged(path, "a complete archive", f"an error ({error})") from error


def damaged(path: Location, expected: str, got: str) -> UserError:
    """Return the error that is raised for a damaged file."""
    return UserError(f"{path}: expected {expected}, got {got}; the file is damaged: copy or export it again")


@contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Raise a UserError that names ``path`` if the code in the ``with`` block cannot write to the disk."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            raise UserError(f"{path}: the disk is full; free some space or write elsewhere with -o") from error
        raise UserError(f"{path}: cannot be written ({error.strerror or error}); write elsewhere with -o") from error
