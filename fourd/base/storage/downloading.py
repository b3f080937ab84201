"""Copies objects to the local disk in pieces. A copy must fit on the disk. If an object is replaced while it is copied,
an error is reported, so a file never mixes two versions of its object.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from io import BufferedReader
from pathlib import Path
from threading import Event
from typing import Any

from fourd.base.errors import UserError
from fourd.base.files import atomic_path, is_unused, write_text_atomically
from fourd.base.limits import open_regular
from fourd.base.progress import Track, untracked
from fourd.base.storage.connection import changed, connect, run_together, storage_errors
from fourd.base.storage.url import StorageUrl
from fourd.base.storage.versions import changed_seconds, object_version

PIECE_BYTES = 8 << 20
"""Number of bytes that one request reads."""
MAX_OBJECTS = 1_000_000
"""Maximum number of objects in a folder."""
MIN_FREE_BYTES = 1 << 30
"""Number of bytes that a copy leaves free on the disk."""
RECORD = ".fetched.jsonl"
"""Name of the record file in the folder that contains a copy. It has one line for each copied object, with its key,
size and version."""
MAX_RECORD_LINE = 1 << 16


@dataclass(frozen=True)
class StoredObject:
    """An object in a store.

    Attributes:
        key: name relative to the listed folder, with slashes, or the last part of the URL if the URL names a single
            object.
        size: size in bytes.
        version: the store's identifiers of the content, such as ETag and time of the last change.
        seconds: time of the last change in seconds since 1970, or None if the store does not report it.
    """

    key: str
    size: int
    version: str
    seconds: float | None


@dataclass(frozen=True)
class Listing:
    """The objects at a URL, sorted by key. ``is_single`` is true if the URL names one object instead of a folder."""

    objects: tuple[StoredObject, ...]
    is_single: bool

    @property
    def version(self) -> str:
        """A hash of the names, sizes and versions of all objects."""
        lines = "\n".join(f"{item.key}\0{item.size}\0{item.version}" for item in self.objects)
        return hashlib.sha256(lines.encode()).hexdigest()[:16]


def list_objects(url: StorageUrl) -> Listing:
    """List the object ``url``, or all objects in the folder ``url``.

    Raises:
        UserError: if nothing exists at ``url``, an object's name cannot be a file name, or the folder has too many
            objects.
    """
    found = _find(url)
    if not found:
        raise UserError(f"{url}: expected an object or a folder with objects, got nothing; check the bucket and name")
    is_single = "" in found
    objects = [replace(item, key=item.key or url.name) for item in found.values()]
    return Listing(tuple(sorted(objects, key=lambda item: item.key)), is_single)


def find_objects(url: StorageUrl) -> list[StoredObject]:
    """List all objects in the folder ``url``, which may be empty. Raises UserError if the store returns an error, an
    object's name cannot be a file name, or the folder has too many objects."""
    return list(_find(url).values())


def _find(url: StorageUrl) -> dict[str, StoredObject]:
    """List all objects at ``url``, as a map from key to object. The key of the object ``url`` itself is empty."""
    store = connect(url)
    with storage_errors(url):
        found: dict[str, dict[str, Any]] = store.find(str(url), detail=True)
    prefix = str(url.path)
    objects = {}
    for name, info in found.items():
        name = name.lstrip("/")
        if info.get("type") != "file" or name.endswith("/"):
            continue  # markers of empty folders
        key = "" if name == prefix else name.removeprefix(f"{prefix}/")
        if not is_file_name(key or url.name):
            raise UserError(
                f"{url}: expected names that can be names of files, got the object {key[:80]!r}; rename the object"
            )
        objects[key] = StoredObject(key, int(info["size"]), object_version(info), changed_seconds(info))
    if len(objects) > MAX_OBJECTS:
        raise UserError(f"{url}: expected at most {MAX_OBJECTS} objects, got {len(objects)}; name a smaller folder")
    return objects


def download(url: StorageUrl, files: Mapping[str, Path]) -> Iterator[StoredObject]:
    """Copy objects in the folder ``url``, and yield each object when its copy is complete.

    Args:
        url: the folder.
        files: maps the key of each object, relative to the folder, to the path of its copy.

    Raises:
        UserError: if the store returns an error, an object is missing or changes while it is read, or the disk has too
            little space.
    """
    found = _find(url) if files else {}
    missing = next((key for key in files if key not in found), None)
    if missing is not None:
        raise changed(url.join(missing))
    due = [found[key] for key in files]
    if due:
        _require_space(url, _existing(next(iter(files.values()))), sum(item.size for item in due))
    yield from _download_all(url, due, {item.key: url.join(item.key) for item in due}, files)


def _existing(path: Path) -> Path:
    """Return the nearest folder above ``path`` that exists."""
    return next(folder for folder in path.absolute().parents if folder.is_dir())


def fetch(url: StorageUrl, parent: Path, track: Track = untracked) -> Path:
    """Copy an object or a folder into the folder ``parent``, under its own name. Returns the path of the copy.

    A second call copies only new and changed objects, and removes copies of objects that no longer exist. Other files
    in the copy are kept. Memory use does not depend on the size of objects, because each connection holds only one
    piece in memory.

    Args:
        url: an object, or a folder of objects.
        parent: local folder that is missing, is empty, or has an earlier copy. If the earlier copy is of another URL,
            all files in ``parent`` are removed first.
        track: reports progress.

    Raises:
        UserError: if the store returns an error, an object changes while it is read, the disk has too little space, or
            ``parent`` contains files that are not from an earlier copy.
    """
    listing = list_objects(url)
    known = _open_record(url, parent)
    target = parent / url.name
    paths = {item.key: target if listing.is_single else target / item.key for item in listing.objects}
    for key in known.keys() - paths.keys():
        (target / key).unlink(missing_ok=True)
    due = [item for item in listing.objects if not _is_current(item, paths[item.key], known.get(item.key))]
    _require_space(url, parent, sum(item.size for item in due))
    urls = {item.key: url if listing.is_single else url.join(item.key) for item in due}
    with (parent / RECORD).open("a", encoding="utf-8") as record:
        for item in track(_download_all(url, due, urls, paths), len(due), f"copying {url.name}"):
            record.write(json.dumps([item.key, item.size, item.version]) + "\n")
            record.flush()
    return target


def _download_all(
    url: StorageUrl, due: list[StoredObject], urls: dict[str, StorageUrl], paths: Mapping[str, Path]
) -> Iterator[StoredObject]:
    """Download objects with several connections, and yield each object when its copy is complete."""
    store = connect(url)
    for index in run_together([partial(_download, store, urls[item.key], item, paths[item.key]) for item in due]):
        yield due[index]


def _download(store: Any, url: StorageUrl, item: StoredObject, path: Path, stop: Event) -> None:
    """Copy one object to ``path``. If ``stop`` is set, the copy is abandoned after the current piece."""
    with storage_errors(url):
        stream = store.open(str(url), "rb", block_size=PIECE_BYTES, cache_type="none")
    with stream, atomic_path(path) as temporary, temporary.open("wb") as out:
        for _ in range(0, item.size, PIECE_BYTES):
            if stop.is_set():
                raise InterruptedError
            with storage_errors(url):
                piece = stream.read(PIECE_BYTES)
            out.write(piece)
        if out.tell() != item.size:
            raise changed(url)
        with storage_errors(url):
            now = store.info(str(url))
        if (int(now["size"]), object_version(now)) != (item.size, item.version):
            raise changed(url)
        out.flush()
        if item.seconds is not None:
            os.utime(temporary, (item.seconds, item.seconds))


def _is_current(item: StoredObject, path: Path, known: tuple[int, str] | None) -> bool:
    """Return True if a copy is complete and has the object's current version. Copies whose key starts with a dot, such
    as files in .fourd/, may differ in size from the object, because fourd may have changed these files."""
    if known != (item.size, item.version) or not path.is_file():
        return False
    return path.stat().st_size == item.size or item.key.startswith(".")


def is_file_name(key: str) -> bool:
    """Return True if a key is a valid name of a file inside a folder on all operating systems."""
    parts = key.split("/")
    return key.isprintable() and not set(key) & set("\\:") and not set(parts) & {"", ".", ".."}


def _require_space(url: StorageUrl, folder: Path, size: int) -> None:
    free = max(0, shutil.disk_usage(folder).free - MIN_FREE_BYTES)
    if size > free:
        raise UserError(
            f"{url}: expected at most {free / 1e9:.1f} GB, the free space in {folder}, got {size / 1e9:.1f} GB; free "
            "disk space, or name a smaller folder"
        )


def _open_record(url: StorageUrl, parent: Path) -> dict[str, tuple[int, str]]:
    """Read the size and version of each copied object in ``parent``. Creates the record if ``parent`` has no copy of
    ``url``."""
    record = parent / RECORD
    first_line = f"{json.dumps([str(url)])}\n"
    if record.is_file():
        with open_regular(record) as lines:
            if lines.readline(MAX_RECORD_LINE) == first_line.encode():
                return _read_lines(lines)
        shutil.rmtree(parent)
    elif not is_unused(parent):
        raise UserError(
            f"{parent}: expected a new folder or a copy from a store, got a folder with other files; move it away"
        )
    write_text_atomically(record, first_line)
    return {}


def _read_lines(lines: BufferedReader) -> dict[str, tuple[int, str]]:
    """Read the lines of a record after the first line, which has the URL. Incomplete lines, which a killed process
    leaves, are skipped."""
    known: dict[str, tuple[int, str]] = {}
    while line := lines.readline(MAX_RECORD_LINE):
        try:
            key, size, version = json.loads(line)
            known[str(key)] = (int(size), str(version))
        except (ValueError, TypeError, RecursionError):
            continue
    return {key: value for key, value in known.items() if is_file_name(key)}
