"""A folder in an object store for the intermediate results of ``fourd make``. For each stage of the pipeline, it has
the files that the stage has written, and a manifest, which lists these files.

``work.json`` marks the folder, ``units/STAGE.json`` is the manifest of a stage, and ``units/STAGE/ATTEMPT/`` has the
files of one execution, where ATTEMPT is a random name. Because each execution writes to a folder of its own and never
replaces files of another execution, a reader never gets a mixture of two executions, and an interrupted upload does not
damage the files of the previous execution.
"""

from __future__ import annotations

import json
import secrets
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fourd.base.errors import UserError
from fourd.base.limits import MAX_TEXT_BYTES
from fourd.base.progress import Track, untracked
from fourd.base.storage import (
    StorageUrl,
    check_writable,
    download,
    find_objects,
    read_object,
    remove_objects,
    upload,
    upload_all,
)
from fourd.pipeline.stored.manifest import Manifest, parse_manifest

MARK = "work.json"
MARK_CONTENT = {"made by": "fourd make", "version": 1}
UNITS = "units"


@dataclass(frozen=True)
class WorkStore:
    """The folder for the intermediate results in an object store, given by its URL. A WorkStore can be pickled and sent
    to other machines."""

    url: StorageUrl

    def open(self) -> dict[str, Manifest]:
        """Mark the folder as a folder of ``fourd make``, and read the manifests of all complete stages.

        Objects of interrupted uploads are removed. A stage with missing objects is not complete.

        Raises:
            UserError: if the store refuses a request, or if the folder has objects but was not created by ``fourd
                make``.
        """
        check_writable(self.url.join(MARK))
        sizes = {item.key: item.size for item in find_objects(self.url)}
        if MARK not in sizes:
            if sizes:
                raise UserError(
                    f"{self.url}: expected a folder made by fourd make, got a folder with other objects; choose "
                    "another --work"
                )
            self._write(MARK, json.dumps(MARK_CONTENT))
        found: dict[str, Manifest] = {}
        for key in sizes:
            if key.startswith(f"{UNITS}/") and key.count("/") == 1 and key.endswith(".json"):
                manifest = parse_manifest(self._read(key) or b"", self.url.join(key))
                if all(sizes.get(_object(manifest, path)) == entry.size for path, entry in manifest.files.items()):
                    found[manifest.name] = manifest
        kept = {_folder(manifest.name, manifest.attempt) for manifest in found.values()}
        self._remove([key for key in sizes if key.count("/") > 2 and "/".join(key.split("/")[:3]) not in kept])
        return found

    def read(self, name: str) -> Manifest | None:
        """Read the manifest of a stage. Returns None if the stage has no manifest."""
        content = self._read(_manifest(name))
        return None if content is None else parse_manifest(content, self.url.join(_manifest(name)))

    def publish(self, manifest: Manifest, files: Mapping[str, Path], track: Track = untracked) -> None:
        """Upload the files of a stage, and then its manifest. Then remove the objects of the stage's previous
        execution.

        Args:
            manifest: the manifest. Its ``attempt`` must be a new name from :func:`new_attempt`.
            files: maps the path of each file in the manifest to the local file to upload.
            track: reports progress.
        """
        before = self.read(manifest.name)
        upload_all(files, self.url.join(_folder(manifest.name, manifest.attempt)), track)
        self._write(_manifest(manifest.name), manifest.to_json())
        if before is not None:
            self._remove([_object(before, path) for path in before.files])

    def download(self, manifest: Manifest, files: Mapping[str, Path], track: Track = untracked) -> None:
        """Copy files of a stage to the local disk. ``files`` maps the path of each file in the manifest to the path of
        its copy."""
        url = self.url.join(_folder(manifest.name, manifest.attempt))
        for _ in track(download(url, files), len(files), f"copying the results of {manifest.name}"):
            pass

    def remove(self, manifest: Manifest) -> None:
        """Remove the manifest of a stage, and then its files."""
        self._remove([_manifest(manifest.name)])
        self._remove([_object(manifest, path) for path in manifest.files])

    def _read(self, key: str) -> bytes | None:
        return read_object(self.url.join(key), MAX_TEXT_BYTES)

    def _write(self, key: str, text: str) -> None:
        with tempfile.TemporaryDirectory(prefix="fourd-") as folder:
            path = Path(folder) / "object"
            path.write_text(text)
            upload(path, self.url.join(key))

    def _remove(self, keys: Sequence[str]) -> None:
        remove_objects(self.url, keys)


def new_attempt() -> str:
    """Return a new random name for the folder with the files of one execution."""
    return secrets.token_hex(8)


def _slug(name: str) -> str:
    return name.replace(" ", "-")


def _manifest(name: str) -> str:
    return f"{UNITS}/{_slug(name)}.json"


def _folder(name: str, attempt: str) -> str:
    return f"{UNITS}/{_slug(name)}/{attempt}"


def _object(manifest: Manifest, path: str) -> str:
    return f"{_folder(manifest.name, manifest.attempt)}/{path}"
