"""Uploads files to object stores, and replaces an object atomically when all its parts have been sent.

Stores cannot rename objects, so a file is sent as the parts of a multipart upload, which are invisible until the upload
is completed. If the process is killed or the connection is lost, the old object stays.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any

from fourd.base.errors import UserError
from fourd.base.files import write_text_atomically
from fourd.base.limits import open_regular, read_json
from fourd.base.progress import Track, untracked
from fourd.base.storage.connection import connect, run_together, storage_errors
from fourd.base.storage.url import StorageUrl, require_object
from fourd.base.storage.versions import object_version

MEGABYTE = 1 << 20
PART_BYTES = 16 * MEGABYTE
"""Size of the parts of an upload in bytes, except for very large files (see MAX_PARTS). One part is in memory at a
time."""
MAX_PARTS = 9000
"""Maximum number of parts of an upload. S3 accepts at most 10,000. If a file is larger than MAX_PARTS * PART_BYTES
bytes, its parts are larger than PART_BYTES.
"""


def upload(path: Path, url: StorageUrl, track: Track = untracked) -> None:
    """Write a local file to the object ``url``. Readers get either its old content or its complete new content.

    Raises:
        UserError: if the store returns an error. After an error, the old object stays, and the parts are removed.
    """
    _upload(connect(url), path, url, track)


def upload_all(files: Mapping[str, Path], url: StorageUrl, track: Track = untracked) -> None:
    """Write local files to objects in the folder ``url``, several at the same time.

    Args:
        files: maps the key of each object, relative to the folder, to its local file.
        url: the folder.
        track: reports progress.

    Raises:
        UserError: if the store returns an error. After an error, some of the objects may be missing.
    """
    store = connect(url)

    def send(key: str, path: Path, stop: Event) -> None:
        if not stop.is_set():
            _upload(store, path, url.join(key), untracked)

    calls = [partial(send, key, path) for key, path in files.items()]
    for _ in track(run_together(calls), len(calls), f"upload to {url.name}"):
        pass


def _upload(store: Any, path: Path, url: StorageUrl, track: Track) -> None:
    with open_regular(path) as source:
        size = path.stat().st_size
        # The part size is a whole number of MiB, because Google Cloud Storage needs a multiple of 256 KiB.
        part = max(PART_BYTES, math.ceil(size / MAX_PARTS / MEGABYTE) * MEGABYTE)
        stream = _open(store, url, part)
        try:
            for _ in track(range(math.ceil(size / part)), math.ceil(size / part), f"upload of {url.name}"):
                content = source.read(part)
                with storage_errors(url):
                    stream.write(content)
            with storage_errors(url):
                stream.close()
                stream.commit()
        except BaseException:
            _discard(stream)
            raise
    with storage_errors(url):
        written = store.info(str(url))["size"]
    if written != size:
        raise UserError(f"{url}: expected {size} bytes after the upload, got {written}; upload the file again")


def upload_changed(path: Path, url: StorageUrl, record: Path, track: Track = untracked) -> None:
    """Upload a file, unless ``record`` shows that the object already has the content of the file.

    Args:
        path: the local file.
        url: the object.
        record: JSON file that is written after each upload. It has the URL, the size and modification time of the local
            file, and the version of the object.
        track: reports progress.

    Raises:
        UserError: see :func:`upload`.
    """
    if record.exists() and _read_record(record) == _state(path, url):
        return
    upload(path, url, track)
    write_text_atomically(record, json.dumps(_state(path, url)) + "\n")


def _state(path: Path, url: StorageUrl) -> list[Any]:
    """Return the URL, the size and modification time of the file, and the version of the object, which is None if the
    object does not exist."""
    status, store = path.stat(), connect(url)
    with storage_errors(url):
        info = store.info(str(url)) if store.exists(str(url)) else None
    return [str(url), status.st_size, status.st_mtime_ns, None if info is None else object_version(info)]


def _read_record(path: Path) -> Any:
    try:
        return read_json(path)
    except ValueError:
        return None


def check_writable(url: StorageUrl) -> None:
    """Start an upload to ``url`` and abort it, so that errors are reported before a long computation.

    The object ``url`` does not change.

    Raises:
        UserError: if the store returns an error.
    """
    stream = _open(connect(url), url, PART_BYTES)
    try:
        with storage_errors(url):
            stream.write(b"\0")
            stream.flush(force=True)
    finally:
        _discard(stream)


def _open(store: Any, url: StorageUrl, part: int) -> Any:
    """Open an object for writing. It changes only when the stream's method ``commit`` is called."""
    require_object(url)
    with storage_errors(url):
        return store.open(str(url), "wb", block_size=part, autocommit=False)


def _discard(stream: Any) -> None:
    """Remove the parts of an upload that was not completed. If the store does not reply, they stay until one of its
    lifecycle rules removes them.
    """
    with suppress(Exception):
        stream.discard()
    # The stream is marked as closed, because its destructor would otherwise close it and send the last part.
    stream.closed = True
