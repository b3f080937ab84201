"""Connections to object stores through fsspec, and conversion of the stores' errors to messages for the user.

The packages for object stores are optional, so they are imported only when the first connection is made. Credentials
and endpoints come from each store's standard settings, such as AWS_ACCESS_KEY_ID, AWS_ENDPOINT_URL and ~/.aws/ for
s3://.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from importlib import import_module
from threading import Event
from typing import Any

from fourd.base.errors import MAX_REASON, UserError, one_line
from fourd.base.storage.url import StorageUrl

CONNECTIONS = 8
"""Number of objects that are read or written at the same time."""
LIBRARIES = ("aiobotocore", "aiohttp", "asyncio", "botocore", "builtins", "fsspec", "gcsfs", "google", "s3fs")
"""Packages whose exceptions :func:`storage_errors` reports as errors of the store. Exceptions of other packages
indicate bugs in fourd and are not converted."""
INSTALL = {
    "s3": ("s3fs", "pip install 'fourd[storage]'"),
    "gs": ("gcsfs", "pip install 'fourd[storage]' gcsfs"),
    "memory": ("fsspec", "pip install 'fourd[storage]'"),
}
"""The package that implements each scheme, and the command that installs it."""
CREDENTIALS = {
    "s3": "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or run aws configure",
    "gs": "run gcloud auth application-default login",
}
REACH = {
    "s3": "check the network, and AWS_ENDPOINT_URL if the store is not Amazon's",
    "gs": "check the network",
}


def connect(url: StorageUrl) -> Any:
    """Open the fsspec file system of a URL. Nothing is sent to the store.

    fsspec caches the file system for later calls in the same thread, because creating it takes longer than a request.
    Listings are not cached, so that changes by other programs become visible.

    Raises:
        UserError: if the package for the scheme is not installed.
    """
    package, command = INSTALL[url.scheme]
    try:
        import fsspec

        import_module(package)
    except ModuleNotFoundError as error:
        raise UserError(f"{url}: expected the package {package}, got none; install it: {command}") from error
    with storage_errors(url):
        if url.scheme == "memory":
            return fsspec.filesystem("memory")
        return fsspec.filesystem(url.scheme, use_listings_cache=False)


@contextmanager
def storage_errors(url: StorageUrl) -> Iterator[None]:
    """Raise a UserError that names ``url`` if a request to the store fails in the ``with`` block, which must contain
    only such requests."""
    try:
        yield
    except (UserError, ImportError, MemoryError):
        raise
    except Exception as error:
        if type(error).__module__.split(".")[0] not in LIBRARIES or not _is_answer(error):
            raise
        raise UserError(f"{url}: {_describe(url, error)}") from error


def changed(url: StorageUrl) -> UserError:
    """Return the error for an object that was replaced or removed while fourd was reading it."""
    return UserError(
        f"{url}: expected an object that stays the same while it is read, got one that was replaced or removed; run "
        "the command again when the object is complete"
    )


def _is_answer(error: Exception) -> bool:
    """Return True if an error comes from the store, and False if it is a bug in the code, such as a TypeError."""
    return isinstance(error, OSError) or type(error).__module__ != "builtins"


def _describe(url: StorageUrl, error: Exception) -> str:
    reason = one_line(error, MAX_REASON) or type(error).__name__
    kind = type(error).__name__
    if kind == "FileExpired":
        return str(changed(url)).removeprefix(f"{url}: ")
    if isinstance(error, FileNotFoundError):
        return f"expected an existing bucket and object, got '{reason}'; check the bucket and the name"
    if isinstance(error, PermissionError):
        return (
            f"expected access to the bucket, got '{reason}'; check the credentials and their permissions to list, read "
            "and write"
        )
    if "Credential" in kind or kind in ("ProfileNotFound", "RefreshError"):
        fix = CREDENTIALS.get(url.scheme, "give credentials")
        return f"expected credentials for the store, got '{reason}'; {fix}"
    if isinstance(error, TimeoutError) or "Connect" in kind or "Timeout" in kind or "HTTPClient" in kind:
        return f"expected a store that answers, got '{reason}'; {REACH.get(url.scheme, 'check the network')}"
    return f"expected a store that accepts the request, got '{reason}'; check the URL and the store, and try again"


def run_together(calls: Sequence[Callable[[Event], object]]) -> Iterator[int]:
    """Run calls at the same time, and yield the index of each call when it is finished.

    Each call gets the same event as its argument. When a call fails, or the caller ends the iteration early, the event
    is set, and calls that have not started are dropped. The error of a failed call is raised again.
    """
    stop = Event()
    with ThreadPoolExecutor(CONNECTIONS) as pool:
        futures = {pool.submit(call, stop): index for index, call in enumerate(calls)}
        try:
            for future in as_completed(futures):
                future.result()
                yield futures[future]
        finally:
            stop.set()
            pool.shutdown(cancel_futures=True)
