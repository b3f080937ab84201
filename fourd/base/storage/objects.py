"""Reads whole small objects, and removes objects."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

from fourd.base.errors import UserError
from fourd.base.storage.connection import connect, storage_errors
from fourd.base.storage.url import StorageUrl

MAX_REMOVED = 1000
"""Maximum number of objects that one request removes."""
PATTERN = frozenset("*?[")
"""Characters that make fsspec interpret a name as a glob pattern."""


def read_object(url: StorageUrl, max_bytes: int) -> bytes | None:
    """Read a small object. Returns None if the object does not exist.

    Raises:
        UserError: if the store returns an error, or the object is larger than ``max_bytes``.
    """
    store = connect(url)
    with storage_errors(url):
        try:
            size = int(store.info(str(url))["size"])
            if size <= max_bytes:
                return bytes(store.cat_file(str(url)))
        except FileNotFoundError:
            return None
    raise UserError(f"{url}: expected at most {max_bytes} bytes, got {size}; delete the object")


def remove_objects(url: StorageUrl, keys: Sequence[str]) -> None:
    """Remove objects. Missing objects are ignored.

    Args:
        url: a folder.
        keys: keys of the objects, relative to the folder.

    Raises:
        UserError: if the store returns an error.
    """
    store = connect(url)
    plain = [str(url.join(key)) for key in keys if not PATTERN & set(key)]
    with storage_errors(url):
        for start in range(0, len(plain), MAX_REMOVED):
            with suppress(FileNotFoundError):
                store.rm(plain[start : start + MAX_REMOVED])
        for key in keys:
            if PATTERN & set(key):
                with suppress(FileNotFoundError):
                    store.rm_file(str(url.join(key)))
