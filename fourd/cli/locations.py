"""Arguments that accept a URL instead of a local path. In all other path arguments, a URL is an error."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Annotated

import tyro

from fourd.base.errors import UserError
from fourd.base.progress import Terminal, Track, Tracker
from fourd.base.storage import Location, StorageUrl, local_copy, parse_location
from fourd.base.storage.url import is_url
from fourd.cli.outputs import READS, WRITES

PATH_OR_URL: tyro.constructors.PrimitiveConstructorSpec[Location] = tyro.constructors.PrimitiveConstructorSpec(
    nargs=1,
    metavar="PATH|URL",
    instance_from_str=lambda words: parse_location(words[0]),
    is_instance=lambda value: isinstance(value, Path | StorageUrl),
    str_from_instance=lambda value: [str(value)],
)
"""Converts a command-line word to a path or to a URL."""

CaptureLocation = tyro.conf.Positional[Annotated[Location, READS, PATH_OR_URL, tyro.conf.arg(metavar="CAPTURE")]]
SceneLocation = tyro.conf.Positional[Annotated[Location, READS, PATH_OR_URL, tyro.conf.arg(metavar="SCENE")]]
OutLocation = Annotated[Location, WRITES, PATH_OR_URL, tyro.conf.arg(aliases=["-o"])]


@contextmanager
def scene_or_copy(location: Location) -> Iterator[Location]:
    """Yield a path or URL from which the scene can be read. A local path is yielded unchanged. The URL of a .4dv
    file is also yielded unchanged, because a .4dv file can be read in parts over the network. Any other URL points to
    an object store such as S3, and its content is copied to a temporary local path, which exists until the ``with``
    block ends."""
    if isinstance(location, Path) or location.suffix.lower() == ".4dv":
        yield location
        return
    with local_copy(location, transfer_progress()) as path:
        yield path


def transfer_progress() -> Track:
    """Return a function that reports the progress of copies from and to an object store on stderr."""
    return Tracker(Terminal(stderr=True)).track


def refuse_urls(arguments: object, words: Sequence[str]) -> None:
    """Raise UserError if a URL was given where only a local path is valid. Without this check, the URL would be used as
    a path.

    Args:
        arguments: the parsed arguments of a command, as a dataclass.
        words: the words on the command line, with the URLs as the user wrote them.
    """
    urls = [text for word in words for text in (word, word.partition("=")[2]) if is_url(text)]
    for path in _paths(arguments) if urls else ():
        url = next((url for url in urls if Path(url) == path), None)
        if url is not None:
            raise UserError(
                f"{url}: expected a local path for this argument, got a URL; copy the files to this machine and name "
                "the copy"
            )


def _paths(value: object) -> Iterator[Path]:
    """Yield all paths in a dataclass, including those in nested tuples and dataclasses."""
    if isinstance(value, Path):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from _paths(item)
    elif is_dataclass(value):
        for field in fields(value):
            yield from _paths(getattr(value, field.name))
