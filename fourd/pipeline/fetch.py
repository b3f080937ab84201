"""Fetch: copies videos or a capture from an object store to the local disk or to a cluster's shared storage."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fourd.base.storage import StorageUrl, fetch, list_objects
from fourd.pipeline.stage import Context, Stage


@dataclass(frozen=True)
class FetchFiles:
    """The folder into which the source is copied. The copy in it is named after the last part of the URL, such as
    ``videos`` for s3://bucket/videos."""

    folder: Path


@dataclass(frozen=True)
class FetchSettings:
    """URL of the source, and a hash of the names, sizes and versions of its objects."""

    url: str
    version: str


def fetch_stage(url: StorageUrl, folder: Path) -> Stage[FetchFiles, FetchSettings]:
    """Create the stage that copies the objects at ``url`` into ``folder``. Raises UserError if the objects cannot be
    listed.
    """
    settings = FetchSettings(str(url), list_objects(url).version)
    return Stage("fetch", run_fetch, FetchFiles(folder), settings, outputs=(fetched_path(url, folder),))


def fetched_path(url: StorageUrl, folder: Path) -> Path:
    """Return the path of the copy that the fetch stage writes."""
    return folder / url.name


def run_fetch(files: FetchFiles, settings: FetchSettings, context: Context) -> None:
    """Copy objects that are new or have changed since the last copy."""
    fetch(StorageUrl(settings.url), files.folder, context.track)
