"""Provides local files in place of objects at URLs, for code that can only read or write files."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fourd.base.errors import UserError
from fourd.base.progress import Track, untracked
from fourd.base.storage.downloading import fetch
from fourd.base.storage.uploading import check_writable, upload
from fourd.base.storage.url import Location, StorageUrl


@contextmanager
def local_copy(location: Location, track: Track = untracked) -> Iterator[Path]:
    """Yield the path of a local file or folder with the content of ``location``. Local paths are yielded unchanged.

    A URL is copied to a temporary folder, which is removed when the block ends. If the block raises a UserError, its
    message names the URL instead of the copy.

    Raises:
        UserError: see :func:`fourd.base.storage.downloading.fetch`.
    """
    if isinstance(location, Path):
        yield location
        return
    with _temporary_folder(location) as folder:
        yield fetch(location, folder, track)


@contextmanager
def local_output(location: Location, track: Track = untracked) -> Iterator[Path]:
    """Yield the path of a local file. If ``location`` is a URL, the file is uploaded when the block ends.

    Local paths are yielded unchanged. For a URL, an upload is started and aborted before the block starts, to test
    whether the store accepts uploads. If the block raises an exception, nothing is uploaded, and the message of a
    UserError names the URL instead of the local file.

    Raises:
        UserError: see :func:`fourd.base.storage.uploading.upload`.
    """
    if isinstance(location, Path):
        yield location
        return
    check_writable(location)
    with _temporary_folder(location) as folder:
        path = folder / location.name
        yield path
        upload(path, location, track)


@contextmanager
def _temporary_folder(url: StorageUrl) -> Iterator[Path]:
    """Yield a temporary folder for the local file or folder that stands for ``url``. In the message of a UserError, the
    URL replaces the path of this file or folder."""
    with tempfile.TemporaryDirectory(prefix="fourd-") as name:
        try:
            yield Path(name)
        except UserError as error:
            raise UserError(str(error).replace(str(Path(name) / url.name), str(url))) from error
