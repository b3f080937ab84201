"""Executes a stage whose results are in an object store: copies its inputs, runs its work, and publishes its
outputs."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

from fourd.base.errors import UserError
from fourd.base.progress import Track
from fourd.base.storage import StorageUrl, fetch, list_objects
from fourd.pipeline.fetch import FetchSettings
from fourd.pipeline.stage import Context, Stage
from fourd.pipeline.stored.cache import Cache, Started, cache_folder
from fourd.pipeline.stored.manifest import Manifest
from fourd.pipeline.stored.unfinished import UPLOAD_SECONDS, Unfinished
from fourd.pipeline.stored.work_store import WorkStore
from fourd.reconstruction.training.run_layout import SOURCE

AnyStage = Stage[Any, Any]


@dataclass(frozen=True)
class UnitFiles:
    """A stage, and everything that another machine needs to execute it.

    Attributes:
        stage: the stage, with paths of the machine that created it.
        root: the folder of the local copy on the machine that created the stage.
        store: the folder for intermediate results.
        source: the URL and the version of a source in an object store, or the path of a source that all nodes can read.
        needs: name and key of each stage whose results the stage reads.
    """

    stage: AnyStage
    root: Path
    store: WorkStore
    source: FetchSettings | Path
    needs: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class UnitSettings:
    """The key of the stage."""

    key: str


def unit_stage(files: UnitFiles, key: str) -> Stage[UnitFiles, UnitSettings]:
    """Create the stage that executes ``files.stage`` on any machine, and publishes its results."""
    stage = files.stage
    unit = Stage(stage.name, run_unit, files, UnitSettings(key), is_parallel=stage.is_parallel)
    return replace(unit, is_portable=True)


def run_unit(files: UnitFiles, settings: UnitSettings, context: Context) -> None:
    """Copy the results that the stage reads, execute the stage, and publish its results.

    If an earlier call was interrupted, the stage resumes from its files if it ran on this machine, or from the
    checkpoints that it uploaded if it ran on another machine.
    """
    if isinstance(files.source, Path) and not files.source.exists():
        raise UserError(
            f"{files.source}: expected the source of fourd make, got no such file or folder; mount it at the same path "
            "on all nodes, or give the source as a URL"
        )
    cache = Cache(cache_folder(files.store.url))
    stage = moved(files.stage, files.root, cache.root)
    needs = _read_needs(files)
    unfinished = None
    if stage.has_checkpoints:
        unfinished = Unfinished(files.store, cache, stage.name, settings.key, UPLOAD_SECONDS)
    with cache.locked():
        started = _prepare(files, stage, settings.key, needs, cache, unfinished, context)
    given = {path: state for need in needs for path, state in need.states().items()}

    def written() -> dict[str, str]:
        """Map the path of each file that the stage has written to its state, a text that changes with the file."""
        states = cache.states(_folders(stage, cache.root))
        return {path: at for path, at in states.items() if at not in (started.before.get(path), given.get(path))}

    with unfinished.uploaded(written, context.log) if unfinished is not None else nullcontext():
        stage.run(context)
    known = stage.readable_settings()
    manifest = cache.publish(
        files.store, stage.name, settings.key, list(written()), settings=known, track=context.track
    )
    cache.mark_published(manifest)
    if unfinished is not None:
        unfinished.remove()


def fetch_source(source: FetchSettings, root: Path, track: Track) -> Path:
    """Download the source of ``fourd make`` from an object store into the folder ``root``, and return the path of the
    downloaded file or folder. Raises UserError if the source has changed since the command started."""
    url = StorageUrl(source.url)
    if list_objects(url).version != source.version:
        raise UserError(
            f"{url}: expected objects that stay the same while fourd make runs, got changed objects; run the command "
            "again"
        )
    return fetch(url, root / SOURCE, track)


def moved(value: Any, old: Path, new: Path) -> Any:
    """Return a copy of ``value`` in which each path inside the folder ``old`` is replaced by the same path inside the
    folder ``new``. Paths in dataclasses and tuples are replaced too. No file is moved."""
    if isinstance(value, Path):
        return new / value.relative_to(old) if value.is_relative_to(old) else value
    if isinstance(value, tuple):
        return tuple(moved(item, old, new) for item in value)
    if is_dataclass(value) and not isinstance(value, type):
        changes = {field.name: moved(getattr(value, field.name), old, new) for field in fields(value) if field.init}
        return replace(value, **changes)
    return value


def _prepare(
    files: UnitFiles,
    stage: AnyStage,
    key: str,
    needs: Sequence[Manifest],
    cache: Cache,
    unfinished: Unfinished | None,
    context: Context,
) -> Started:
    """Copy everything that the stage reads. Files that the stage wrote with another key are removed."""
    track, folders = context.track, _folders(stage, cache.root)
    started = cache.started(stage.name)
    own = cache.own_paths(stage.name, folders)
    if started is None or started.key != key:
        started = None
        for leftovers in stage.leftovers:
            leftovers.remove()
    if not stage.is_parallel:
        # A stage that is not parallel may read whole folders, so files that were made with other settings are removed
        # from them.
        cache.remove_others({stage.name, *(need.name for need in needs)})
    if isinstance(files.source, FetchSettings):
        fetch_source(files.source, cache.root, track)
    cache.copy(files.store, needs, track)
    if started is None:
        # ``before`` contains the files that exist before the stage starts. They are published only if the stage changes
        # them. The stage's own files must always be published, so ``before`` excludes them: the files of its earlier
        # executions on this machine, and the files that it uploaded when it ran on another machine.
        uploaded = unfinished.fetch(context.log, track) if unfinished is not None else None
        own |= set(uploaded.states()) if uploaded is not None else set()
        before = {path: state for path, state in cache.states(folders).items() if path not in own}
        started = Started(key, before, stage.leftovers)
        cache.mark_started(stage.name, started)
    return started


def _folders(stage: AnyStage, root: Path) -> list[Path]:
    """Return the folders into which a stage writes. A parallel stage writes only to the folders in ``stage.leftovers``,
    which lists the files to remove before the stage starts with a new key. Other stages may write to the rest of
    ``root`` at the same time."""
    return [leftovers.folder for leftovers in stage.leftovers] if stage.is_parallel else [root]


def _read_needs(files: UnitFiles) -> list[Manifest]:
    found = []
    for name, key in files.needs:
        manifest = files.store.read(name)
        if manifest is None or manifest.key != key:
            raise UserError(
                f"{files.store.url}: expected the results of stage {name} of this command, got those of another one; "
                "run one fourd make at a time with this --work"
            )
        found.append(manifest)
    return found
