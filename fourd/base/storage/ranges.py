"""Opens objects in a store as readable files. A read downloads only a range of bytes, without a copy of the whole
object."""

from __future__ import annotations

import io
from threading import Lock
from typing import Any, BinaryIO, cast

from fourd.base.storage.connection import changed, connect, storage_errors
from fourd.base.storage.url import StorageUrl, require_object
from fourd.base.storage.versions import object_version

READ_AHEAD_BYTES = 256 << 10
"""Minimum number of bytes that a request reads. If a caller reads fewer bytes, the rest is kept for the next reads. If
a caller reads more bytes, they are read with a single request."""


def open_object(url: StorageUrl) -> BinaryIO:
    """Open an object for reading at any position. Memory use does not depend on the size of the object.

    All bytes come from the version of the object that existed when the object was opened.

    Raises:
        UserError: if the store returns an error or the object does not exist. Reads raise UserError if the object has
        changed.
    """
    require_object(url)
    store = connect(url)
    with storage_errors(url):
        stream = store.open(str(url), "rb", cache_type="none")
        version = object_version(store.info(str(url)))
    return cast(BinaryIO, io.BufferedReader(_Ranges(url, store, stream, version), READ_AHEAD_BYTES))


class _Ranges(io.RawIOBase):
    """The bytes of one version of an object. Single reads are locked, but another thread can change the position
    between a seek and the next read, so threads that share an instance must take turns."""

    def __init__(self, url: StorageUrl, store: Any, stream: Any, version: str) -> None:
        self._url = url
        self._store = store
        self._stream = stream
        self._version = version
        self._lock = Lock()

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, origin: int = io.SEEK_SET) -> int:
        return int(self._stream.seek(offset, origin))

    def tell(self) -> int:
        return int(self._stream.tell())

    def readinto(self, buffer: Any) -> int:
        with self._lock, storage_errors(self._url):
            content = self._stream.read(len(buffer))
            # S3 itself rejects a read if the object has changed since it was opened. For other stores, the object's
            # current version is compared with its version at that time.
            if self._url.scheme != "s3" and object_version(self._store.info(str(self._url))) != self._version:
                raise changed(self._url)
        buffer[: len(content)] = content
        return len(content)

    def close(self) -> None:
        if not self.closed:
            self._stream.close()
        super().close()
