"""The local folder for intermediate results: its record, and what happens to files that were made with other settings.

Results that are quick to make are removed. A trained run is renamed (see :mod:`fourd.pipeline.work.kept`), and renamed
back when a later command has its settings again.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fourd.base.errors import UserError
from fourd.base.files import resolved
from fourd.base.progress import Log
from fourd.base.storage import Location
from fourd.pipeline.stage import Leftovers, Stage, StageState
from fourd.pipeline.work.kept import (
    Trained,
    bring_back,
    find_trained,
    folder_size,
    is_segment,
    keep_capture,
    keep_run,
    kept_folders,
    readable_size,
    readers,
    run_of,
)
from fourd.pipeline.work.record import Record, StageEntry, shown_changes
from fourd.reconstruction.training.run_layout import PREPARATION

AnyStage = Stage[Any, Any]
RUN = "run"
"""Name of the run's folder in the folder for intermediate results."""
TRAINING = "train"
"""First word of the names of the stages that train."""
BAKING = "bake"
"""Name of the stage that writes the scene."""


class WorkFolder:
    """The local folder for intermediate results, which this process has locked."""

    def __init__(self, record: Path, log: Log, *, force: bool = False) -> None:
        """Read the record.

        Args:
            record: the record file, which is in the folder.
            log: prints a line.
            force: whether to remove trained runs whose settings have changed, instead of keeping them.
        """
        self._path = record
        self._log = log
        self._force = force
        self._run = record.parent / RUN
        self._record = Record.read(record)

    def claim(self, scene: Location) -> None:
        """Record that the folder belongs to ``scene``.

        Raises:
            UserError: if it belongs to another scene, unless the file of this other scene was finished and is gone.
        """
        folder = self._path.parent
        name = os.path.relpath(resolved(scene), resolved(folder.parent)) if isinstance(scene, Path) else str(scene)
        owner = self._record.scene
        if owner is not None and owner != name:
            other = folder.parent / owner
            is_same = isinstance(scene, Path) and other.exists() and scene.exists() and other.samefile(scene)
            is_gone = "://" not in owner and not other.exists() and self._record.entry(BAKING).finished is not None
            if not is_same and not is_gone:
                raise UserError(
                    f"{folder}: expected the folder for intermediate results of {scene}, got that of "
                    f"{owner if '://' in owner else other}; name this scene with -o, or another folder with --work"
                )
        # The record is written when the first stage starts, so that an invalid command leaves no folder.
        self._record = replace(self._record, scene=name)

    def is_finished(self, stage: AnyStage, key: str) -> bool:
        """Return whether the stage was finished with ``key`` and its outputs still exist."""
        return self._record.entry(stage.name).finished == key and stage.is_finished()

    def start(self, stage: AnyStage, state: StageState, done: Sequence[str], later: Sequence[AnyStage]) -> bool:
        """Prepare the folder for the work of a stage, and return whether the work must run.

        Files that the stage wrote with another key are removed or kept, and what has changed is printed.

        Args:
            stage: the stage.
            state: its state.
            done: names of the stages that this command has already finished.
            later: stages that this command will start after this one.
        """
        is_new = not self.is_finished(stage, state.key) and self._record.entry(stage.name).started != state.key
        if is_new and not self._bring_back(stage, state.key):
            self._clear(stage, state, done, later)
        if self.is_finished(stage, state.key):
            return False
        self._write({stage.name: StageEntry(state.key, None, self._place(stage), state)})
        return True

    def finish(self, stage: AnyStage, key: str) -> None:
        """Record that the stage is finished."""
        self._write({stage.name: replace(self._record.entry(stage.name), finished=key)})

    def _clear(self, stage: AnyStage, state: StageState, done: Sequence[str], later: Sequence[AnyStage]) -> None:
        """Remove or keep the files that the stage wrote with another key."""
        before = self._record
        is_trained = any(find_trained(run_of(each.folder)) for each in stage.leftovers)
        if stage.name in before.stages:
            changes = before.entry(stage.name).changes(state)
            for each in later if is_trained else ():
                changes += before.entry(each.name).changed_settings(each.readable_settings())
            self._log(f"{stage.name}: again, because {shown_changes(changes)}")
        # The key is deleted before the files, so that no key matches the remaining files if the removal is interrupted.
        self._write({stage.name: None})
        for leftovers in stage.leftovers:
            trained = find_trained(run_of(leftovers.folder))
            if trained is not None:
                self._replace_run(trained, leftovers, before, done, later)
            else:
                self._keep_read(leftovers.folder)
            leftovers.remove()

    def _replace_run(
        self,
        trained: Trained,
        leftovers: Leftovers,
        before: Record,
        done: Sequence[str],
        later: Sequence[AnyStage],
    ) -> None:
        """Rename a trained run whose settings have changed, or remove it if the user wants this. The entries of stages
        stay if they are ``done``, or if their files stay in the folder of the run."""
        run = trained.folder
        shared = [name for name in PREPARATION if leftovers.folder != run or name in leftovers.keep]
        folders = [run / name for name in shared]
        stay = [*done, *(each.name for each in later if _is_inside(each.outputs, folders))]
        entries = {name: entry for name, entry in before.stages.items() if entry.place == self._run.name}
        whole = [entry.finished is not None for name, entry in entries.items() if name.startswith(TRAINING)]
        what = f"the {'finished' if whole and all(whole) else 'unfinished'} run of {trained.steps:,} steps"
        self._write({name: None for name in entries if name not in stay})
        if self._force:
            Leftovers(run, tuple(shared)).remove()
            self._log(f"{run}: {what} is deleted, because of --force")
            return
        kept = keep_run(run, () if is_segment(run) else shared)
        self._record = replace(self._record, kept={**self._record.kept, kept.name: entries})
        self._record.write(self._path)
        size = readable_size(trained.nbytes)
        self._log(f"{run}: {what} is kept as {kept} ({size}); delete that folder if you do not need it")

    def _keep_read(self, capture: Path) -> None:
        """Rename a capture that trained runs read, because without it they could not be rendered any more."""
        runs = [*kept_folders(self._run), *(() if self._force else (self._run,))]
        reading = readers(capture, runs) if capture.is_dir() and capture.parent == self._run.parent else []
        if not reading:
            return
        size = readable_size(folder_size(capture))
        names = ", ".join(str(run) for run in reading)
        kept = keep_capture(capture, runs)
        self._log(f"{capture}: kept as {kept} ({size}), because it is read by {names}")

    def _bring_back(self, stage: AnyStage, key: str) -> bool:
        """If a run was kept whose training had the key ``key``, use it again, and return True."""
        if not stage.starts_run:
            return False
        run = stage.leftovers[0].folder
        for kept in kept_folders(run):
            entries = self._record.kept.get(kept.name, {})
            if entries.get(stage.name, StageEntry()).started != key:
                continue
            trained = find_trained(run)
            if trained is not None:
                self._replace_run(trained, stage.leftovers[0], self._record, (), ())
            self._write({name: None for name, entry in self._record.stages.items() if entry.place == run.name})
            bring_back(kept, run, stage.files.capture)
            others = {name: each for name, each in self._record.kept.items() if name != kept.name}
            self._record = replace(self._record, kept=others)
            self._write(entries)
            self._log(f"{run}: {kept} has these settings and is used again")
            return True
        return False

    def _place(self, stage: AnyStage) -> str | None:
        """Return the name of the folder, in the folder for intermediate results, to which a stage writes."""
        folder = self._path.parent
        inside = [path.relative_to(folder) for path in stage.outputs if path.is_relative_to(folder)]
        return inside[0].parts[0] if inside and inside[0].parts else None

    def _write(self, changes: Mapping[str, StageEntry | None]) -> None:
        self._record = self._record.with_entries(changes)
        self._record.write(self._path)


def _is_inside(outputs: Sequence[Path], folders: Sequence[Path]) -> bool:
    """Return whether there are outputs, and each is in one of the folders."""
    return bool(outputs) and all(any(path.is_relative_to(folder) for folder in folders) for path in outputs)
