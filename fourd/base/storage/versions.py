"""Computes the version of an object from the description that fsspec returns."""

from __future__ import annotations

from datetime import datetime
from typing import Any


def object_version(info: dict[str, Any]) -> str:
    """Return the identifiers of an object's content: size, ETag or another hash, and time of the last change."""
    tag = next((str(info[name]) for name in ("ETag", "etag", "md5Hash", "generation") if info.get(name)), "")
    seconds = changed_seconds(info)
    # A listing and a request for a single object can report different fractions of a second, so the fractions are kept
    # only if the store reports no hash.
    time = "" if seconds is None else str(int(seconds) if tag else seconds)
    return f"{info['size']} {tag} {time}".strip()


def changed_seconds(info: dict[str, Any]) -> float | None:
    """Return the time of the last change in seconds since 1970, or None if the store does not report it."""
    for name in ("LastModified", "mtime", "updated", "created"):
        value = info.get(name)
        if isinstance(value, datetime):
            return value.timestamp()
        if isinstance(value, str):
            return datetime.fromisoformat(value).timestamp()
        if isinstance(value, int | float):
            return float(value)
    return None
