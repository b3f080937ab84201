"""Manifests: lists of the files that a stage has written. A manifest is published after the files that it lists."""

from __future__ import annotations

import json
import posixpath
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import NamedTuple

from fourd.base.errors import UserError
from fourd.base.json_file import decode_json
from fourd.base.limits import parse_json
from fourd.base.storage import StorageUrl, is_file_name
from fourd.reconstruction.training.run_layout import CONFIG_NAME
from fourd.recording.capture.layout import DERIVED

VERSION = 1
LINKED = ("capture", "repaired", "still")
"""The only folders in which a manifest may list symbolic links. Stages write files into all other folders, where a link
could redirect the written files, so links there are refused."""


class FileEntry(NamedTuple):
    """An uploaded file: the size of its object in bytes, and the time of the file's last change in nanoseconds since
    1970."""

    size: int
    changed_ns: int


@dataclass(frozen=True)
class Manifest:
    """The files that a stage has written.

    Attributes:
        name: name of the stage.
        key: key of the stage; see :meth:`fourd.pipeline.stage.Stage.key`.
        attempt: name of the folder in the object store to which the files were uploaded. Each execution of the stage
            has its own folder, so that objects never change.
        files: maps the path of each file, relative to the folder for intermediate results, to its size and time.
        links: maps the path of each symbolic link to its target, as an absolute path or relative to the folder for
            intermediate results.
        settings: the value of each setting of the stage as text, by its name; empty if it is not known.
    """

    name: str
    key: str
    attempt: str
    files: Mapping[str, FileEntry]
    links: Mapping[str, str]
    settings: Mapping[str, str] = field(default_factory=dict)

    def to_json(self) -> str:
        """Convert the manifest to the JSON text that :func:`parse_manifest` reads."""
        return json.dumps(
            {
                "version": VERSION,
                "name": self.name,
                "key": self.key,
                "attempt": self.attempt,
                "files": dict(self.files),
                "links": dict(self.links),
                "settings": dict(self.settings),
            }
        )

    def states(self) -> dict[str, str]:
        """Return the state of each file and link by path; see :func:`file_state`."""
        states = {path: file_state(path, entry.size, entry.changed_ns) for path, entry in self.files.items()}
        return {**states, **{path: link_state(target) for path, target in self.links.items()}}


def file_state(path: str, size: int, changed_ns: int) -> str:
    """Return a text with the size and the time of the last change of a file, so that the text changes when the file
    changes. For the config of a run, the text leaves out the size, which differs between machines because the config
    contains the path of the capture."""
    return f"{0 if is_config(path) else size} {changed_ns}"


def link_state(target: str) -> str:
    """Return a text that changes when a symbolic link changes."""
    return f"-> {target}"


def is_config(path: str) -> bool:
    """Return True if a file is the config of a run."""
    return posixpath.basename(path) == CONFIG_NAME


def parse_manifest(content: bytes, url: StorageUrl) -> Manifest:
    """Read a manifest from the object ``url``.

    Raises:
        UserError: if the object is not a manifest, has another format version, or lists a path that could be outside
            the folder for intermediate results, or a link that no stage makes.
    """
    try:
        values = parse_json(content)
        if values["version"] != VERSION:
            raise UserError(f"{url}: expected version {VERSION}, got {values['version']}; update fourd on all nodes")
        manifest = decode_json(values, Manifest)
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"{url}: expected a manifest of fourd make, got other content; delete the object") from error
    if not (
        manifest.attempt.isalnum()
        and all(map(is_file_name, manifest.files))
        and all(map(_is_link, manifest.links.items()))
    ):
        raise UserError(f"{url}: expected names of files of fourd make, got other names; delete the object")
    return manifest


def _is_link(item: tuple[str, str]) -> bool:
    """Return True if the item (a path and a target) describes a symbolic link that a stage may make."""
    path, target = item
    parts = PurePosixPath(path).parts
    inside = is_file_name(path) and len(parts) > 1 and parts[0] in LINKED and DERIVED.name not in parts
    return inside and target.isprintable() and (target.startswith("/") or is_file_name(target))
