"""URLs of objects and folders in object stores, such as s3://bucket/scene.4dv."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from fourd.base.errors import UserError

URL = re.compile(r"(?P<scheme>[A-Za-z][A-Za-z0-9+.-]+)://(?P<rest>.*)", re.DOTALL)
"""Pattern of a URL with any scheme. A scheme has at least two characters, so that Windows paths such as C:/videos are
not URLs."""
SCHEMES = ("s3", "gs", "memory")
"""Supported schemes, whose stores replace an object atomically when an upload is completed. memory:// is a store in the
memory of this process, which tests and Python programs that import fourd can use."""


@dataclass(frozen=True)
class StorageUrl:
    """The URL of an object or of a folder. A folder consists of all objects whose keys start with the folder's path.
    :func:`parse_location` checks URLs.

    The part after the scheme is used without percent-decoding, as in other programs for these stores.
    """

    text: str

    def __str__(self) -> str:
        return self.text

    @property
    def scheme(self) -> str:
        """The part before ://, such as s3."""
        return self.text.partition("://")[0]

    @property
    def path(self) -> PurePosixPath:
        """Bucket and key."""
        return PurePosixPath(self.text.partition("://")[2])

    @property
    def name(self) -> str:
        """The last part of the path."""
        return self.path.name

    @property
    def suffix(self) -> str:
        """The suffix of the name, such as .4dv."""
        return self.path.suffix

    def join(self, key: str) -> StorageUrl:
        """Return the URL of the object ``key`` in the folder that this URL names."""
        return StorageUrl(f"{self.text.rstrip('/')}/{key}")


def local_path(location: Location | str, use: str) -> Path:
    """Return the path of a file or folder on this machine.

    Raises:
        UserError: if the text is a URL of a store. In the error message, ``use`` completes the phrase "expected a local
            path to".
    """
    found = parse_location(location)
    if isinstance(found, Path):
        return found
    raise UserError(f"{found}: expected a local path to {use}, got a URL; use a path of this machine")


def require_object(url: StorageUrl) -> None:
    """Raise UserError if a URL names only a bucket and no object in the bucket."""
    if len(url.path.parts) < 2:
        raise UserError(f"{url}: expected the name of an object in the bucket, got only a bucket; write {url}/NAME")


Location = Path | StorageUrl
"""A local path, or a URL."""


def is_url(text: str) -> bool:
    """Return True if a text is a URL, even if fourd does not support its scheme."""
    return URL.fullmatch(text) is not None


def parse_location(text: Location | str) -> Location:
    """Convert a text to a local path, or to a URL. file:// URLs become local paths. Values that are already paths or
    StorageUrls are returned unchanged.

    Raises:
        UserError: if the scheme is not supported, or the URL names no bucket.
    """
    if not isinstance(text, str):
        return text
    match = URL.fullmatch(text)
    if match is None:
        return Path(text)
    scheme, rest = match["scheme"].lower(), match["rest"]
    if scheme == "file":
        if not rest.startswith("/"):
            raise UserError(f"{text}: expected an absolute path after file://, got '{rest}'; write file:///folder/name")
        return Path(rest)
    if scheme not in SCHEMES:
        raise UserError(
            f"{text}: expected a local path, or a URL that starts with s3://, gs:// or file://, got {scheme}://; copy "
            "the files to this machine or to one of these stores"
        )
    parts = rest.strip("/").split("/")
    if not parts[0] or any(part in ("", ".", "..") for part in parts) or not rest.isprintable():
        raise UserError(f"{text}: expected {scheme}://BUCKET/NAME, got another form; write the bucket and the name")
    return StorageUrl(f"{scheme}://{'/'.join(parts)}")
