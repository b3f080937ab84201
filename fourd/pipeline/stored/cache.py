"""The local copy of a folder for intermediate results in an object store."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence, Set
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import platformdirs

from fourd.base.configs import save_config
from fourd.base.errors import UserError
from fourd.base.files import UNFINISHED, resolved, write_text_atomically
from fourd.base.limits import read_json
from fourd.base.processes import locked_file
from fourd.base.progress import Track, untracked
from fourd.base.storage import StorageUrl, is_file_name
from fourd.base.storage.downloading import RECORD
from fourd.pipeline.stage import Leftovers
from fourd.pipeline.stored.manifest import FileEntry, Manifest, file_state, is_config, link_state
from fourd.pipeline.stored.work_store import WorkStore, new_attempt
from fourd.reconstruction.training.run import load_run_config
from fourd.reconstruction.training.run_layout import SCRATCH

CACHE_VARIABLE = "FOURD_CACHE"
"""Environment variable with the path of the folder in which this machine keeps its local copies of folders for
intermediate results. If it is not set, the user's cache folder is used."""
OWN = ".stored"
"""Folder with the records of the local copy: a manifest for each stage whose files were copied or published, and a mark
(see :class:`Started`) for each stage that was started and has not published its results."""


@dataclass(frozen=True)
class Started:
    """The record that a stage was started on this machine. Other texts call it the mark of the stage.

    Attributes:
        key: the stage's key.
        before: the files that existed when the stage was started, in the folders to which it writes. The stage's own
            files are left out. Each file's path is mapped to the state that the file had at that time. The state is a
            text that changes with the file; see :meth:`Cache.states`.
        leftovers: the stage's field ``leftovers``.
    """

    key: str
    before: Mapping[str, str]
    leftovers: tuple[Leftovers, ...]


def cache_folder(url: StorageUrl) -> Path:
    """Return the folder of the local copy of ``url`` on this machine."""
    given = os.environ.get(CACHE_VARIABLE)
    parent = Path(given) if given else platformdirs.user_cache_path("fourd")
    return resolved(parent / "work" / f"{url.name}-{hashlib.sha256(str(url).encode()).hexdigest()[:16]}")


@dataclass(frozen=True)
class Cache:
    """The local copy, in the folder ``root``, of a folder for intermediate results in an object store. Several
    processes can share the local copy, because they copy and remove files only inside :meth:`locked`."""

    root: Path

    def locked(self) -> AbstractContextManager[None]:
        """Return a context manager that prevents other processes from copying files into this folder."""
        return locked_file(self.root / OWN / "lock")

    def started(self, name: str) -> Started | None:
        """Return the mark of a stage if it was started on this machine and has not published its results, otherwise
        None."""
        try:
            values = read_json(self._mark(name))
            leftovers = tuple(Leftovers(self.root / folder, tuple(keep)) for folder, keep in values["leftovers"])
            return Started(values["key"], values["before"], leftovers)
        except (OSError, ValueError, KeyError, TypeError):
            return None

    def mark_started(self, name: str, started: Started) -> None:
        """Write the mark of a stage, and remove its local manifest, because the stage will change its files."""
        leftovers = [[each.folder.relative_to(self.root).as_posix(), each.keep] for each in started.leftovers]
        text = json.dumps({"key": started.key, "before": dict(started.before), "leftovers": leftovers})
        write_text_atomically(self._mark(name), text)
        self._copy(name).unlink(missing_ok=True)

    def mark_published(self, manifest: Manifest) -> None:
        """Record that the local files of a stage agree with its manifest."""
        write_text_atomically(self._copy(manifest.name), manifest.to_json())
        self._mark(manifest.name).unlink(missing_ok=True)

    def forget(self, name: str) -> None:
        """Remove the local manifest ``name``, but keep the files that it lists."""
        self._copy(name).unlink(missing_ok=True)

    def own_paths(self, name: str, folders: Sequence[Path]) -> set[str]:
        """Return the paths of a stage's files and links. If the stage has a mark (see :meth:`started`), these are the
        files and links in ``folders`` whose states differ from those in the mark, or are missing in it. Otherwise, they
        are the files and links that were copied to this machine or published from it."""
        started = self.started(name)
        if started is None:
            return self._copied(name)
        return {path for path, state in self.states(folders).items() if state != started.before.get(path)}

    def states(self, folders: Sequence[Path]) -> dict[str, str]:
        """Map the path of each file and link in ``folders`` to its state; see ``manifest.file_state``. Temporary files
        are left out."""
        found: dict[str, str] = {}
        for folder in folders:
            for parent, names, files in os.walk(folder):
                links = [name for name in names if Path(parent, name).is_symlink()]
                names[:] = [name for name in names if not _is_temporary(name)]
                for name in (*links, *files):
                    if not _is_temporary(name):
                        path = Path(parent, name).relative_to(self.root).as_posix()
                        found[path] = self._state(path)
        return found

    def copy(self, store: WorkStore, manifests: Sequence[Manifest], track: Track) -> None:
        """Copy each file that ``manifests`` list and that is missing on this machine or has changed. If several
        manifests contain a path, the last one is used. Local files that are no longer in a stage's manifest are
        removed."""
        wanted = {path: manifest for manifest in manifests for path in (*manifest.files, *manifest.links)}
        for manifest in manifests:
            self._remove_old(manifest.name, wanted.keys())
        for manifest in manifests:
            states = manifest.states()
            due = [path for path in states if wanted[path] is manifest and self._state(path) != states[path]]
            targets = {path: self._target(path) for path in due}
            store.download(manifest, {path: targets[path] for path in due if path in manifest.files}, track)
            for path in due:
                if path in manifest.files:
                    self._finish(path, targets[path], manifest.files[path])
                else:
                    targets[path].symlink_to(self.root / manifest.links[path])
            self.mark_published(manifest)

    def publish(
        self,
        store: WorkStore,
        name: str,
        key: str,
        paths: Sequence[str],
        *,
        copies: Path | None = None,
        settings: Mapping[str, str] | None = None,
        track: Track = untracked,
    ) -> Manifest:
        """Upload the files and symbolic links that a stage wrote, and then their manifest.

        Args:
            store: the folder for intermediate results.
            name: name of the manifest.
            key: key of the stage.
            paths: paths of the files and links.
            copies: folder with copies of the files, which are uploaded instead. If None, the files themselves are
                uploaded.
            settings: the value of each setting of the stage as text, by its name.
            track: reports progress.

        Returns: the manifest.
        """
        links = {path for path in paths if (self.root / path).is_symlink()}
        local = {path: (copies or self.root) / path for path in paths if path not in links}
        times = {path: each.stat().st_mtime_ns for path, each in local.items()}
        targets = {path: self._portable(Path(os.readlink(self.root / path))) for path in links}
        with self._portable_configs(local) as sent:
            files = {path: FileEntry(each.stat().st_size, times[path]) for path, each in sent.items()}
            manifest = Manifest(name, key, new_attempt(), files, targets, settings or {})
            store.publish(manifest, sent, track)
        return manifest

    @contextmanager
    def copies(self, name: str) -> Iterator[Path]:
        """Yield an empty folder for copies of a running stage's files, and remove it afterwards."""
        folder = self._copies(name)
        shutil.rmtree(folder, ignore_errors=True)
        try:
            folder.mkdir(parents=True)
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    @contextmanager
    def _portable_configs(self, local: Mapping[str, Path]) -> Iterator[dict[str, Path]]:
        """Yield the file to upload for each path. Run configs are replaced by copies in which the path of the capture
        is relative to the folder ``root``."""
        with tempfile.TemporaryDirectory(prefix="fourd-") as folder:
            sent = dict(local)
            for number, path in enumerate(filter(is_config, local)):
                config = load_run_config(sent[path])
                sent[path] = Path(folder) / str(number)
                save_config(replace(config, capture=Path(self._portable(config.capture))), sent[path])
            yield sent

    def _portable(self, path: Path) -> str:
        """Return the path relative to the folder ``root``, or the unchanged path if it is outside."""
        return path.relative_to(self.root).as_posix() if path.is_relative_to(self.root) else str(path)

    def _state(self, path: str) -> str:
        local = self.root / path
        try:
            if local.is_symlink():
                return link_state(self._portable(Path(os.readlink(local))))
            status = local.stat()
        except OSError:
            return "missing"
        return file_state(path, status.st_size, status.st_mtime_ns)

    def _target(self, path: str) -> Path:
        """Return the local path of a file to be written, and remove any file, link or folder at this path."""
        target = self.root / path
        if self._is_behind_link(path):
            raise UserError(f"{target}: expected a folder in the local copy, got a link; delete {self.root}")
        if target.is_dir() and not target.is_symlink():
            shutil.rmtree(target)
        else:
            target.unlink(missing_ok=True)
        target.parent.mkdir(parents=True, exist_ok=True)
        return target

    def _finish(self, path: str, target: Path, entry: FileEntry) -> None:
        if is_config(path):
            config = load_run_config(target)
            save_config(replace(config, capture=self.root / config.capture), target)
        os.utime(target, ns=(entry.changed_ns, entry.changed_ns))

    def remove_others(self, names: Set[str]) -> None:
        """Remove the files of all stages except those in ``names``."""
        marks = {path.name.removesuffix(".json").removesuffix(".started") for path in (self.root / OWN).glob("*.json")}
        kept = {path for name in names & marks for path in self._copied(name)}
        for name in marks - names:
            self._remove_old(name, kept)
            self._copy(name).unlink(missing_ok=True)
            self._mark(name).unlink(missing_ok=True)

    def _remove_old(self, name: str, wanted: Set[str]) -> None:
        """Remove the files in the recorded manifest of the stage ``name``, except those in ``wanted``. If the stage did
        not finish on this machine, also remove the files that it left."""
        started = self.started(name)
        for leftovers in started.leftovers if started is not None else ():
            leftovers.remove()
        shutil.rmtree(self._copies(name), ignore_errors=True)
        for path in self._copied(name) - wanted:
            if is_file_name(path) and not self._is_behind_link(path):
                (self.root / path).unlink(missing_ok=True)
                # Empty folders are removed, because the empty folder of a segment would look like a run.
                for parent in list(Path(path).parents)[:-1]:
                    with suppress(OSError):
                        (self.root / parent).rmdir()

    def _copied(self, name: str) -> set[str]:
        """Return the paths of a stage's files and links that were copied to this machine or published from it."""
        try:
            manifest = read_json(self._copy(name))
            return {*manifest["files"], *manifest["links"]}
        except (OSError, ValueError, KeyError, TypeError):
            return set()

    def _is_behind_link(self, path: str) -> bool:
        """Return True if a parent folder of a path is a symbolic link. The file at this path is then not in the local
        copy, but in the folder to which the link points."""
        return any((self.root / parent).is_symlink() for parent in Path(path).parents)

    def _mark(self, name: str) -> Path:
        return self.root / OWN / f"{name}.started.json"

    def _copies(self, name: str) -> Path:
        return self.root / OWN / f"{name}.copies"

    def _copy(self, name: str) -> Path:
        return self.root / OWN / f"{name}.json"


def _is_temporary(name: str) -> bool:
    return name in (OWN, SCRATCH, RECORD) or name.startswith(UNFINISHED)
