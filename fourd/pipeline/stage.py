"""A stage: a frozen, picklable description of one step of the pipeline, which reads and writes files."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from rich.console import Console

from fourd.base.files import resolved
from fourd.base.progress import Log, Terminal, Track, Tracker, console_log
from fourd.pipeline.workload import Workload

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    from fourd.reconstruction.training.distributed.process_group import ProcessGroup
    from fourd.reconstruction.training.loop import OnStep
    from fourd.rendering.ops.device_name import DeviceName

Files = TypeVar("Files", bound="DataclassInstance")
Settings = TypeVar("Settings", bound="DataclassInstance")


@dataclass(frozen=True)
class NoSettings:
    """Empty settings, for a stage that has no settings."""


@dataclass(frozen=True)
class Context:
    """Runtime context of a stage. It does not affect the results of a stage, except that the number of ranks determines
    the order in which views are trained, and that a GPU rounds differently from a CPU.

    Attributes:
        console: console on which progress and log lines are printed.
        workers: number of processes that the work may use.
        group: the ranks (processes) that train together. All ranks execute the stages that train, and only rank 0
            executes the other stages. If None, this process works alone.
        device: device that trains.
        on_step: function that is called after each training step, or None.
    """

    console: Console = field(default_factory=lambda: Terminal(quiet=True))
    workers: int = 1
    group: ProcessGroup | None = None
    device: DeviceName = "cpu"
    on_step: OnStep | None = None

    @property
    def track(self) -> Track:
        """Progress bars on the console."""
        return Tracker(self.console).track

    @property
    def log(self) -> Log:
        """Logging callback that prints lines on the console."""
        return console_log(self.console)


@dataclass(frozen=True)
class Artefact:
    """Files that a stage reads. Their version is identified by their names, sizes and modification times.

    Attributes:
        path: a file, or a folder to which ``patterns`` are relative.
        patterns: glob patterns; empty if ``path`` is a file.
    """

    path: Path
    patterns: tuple[str, ...] = ()

    def fingerprint(self, root: Path | None = None) -> str:
        """Return a hash of the path, and of the names, sizes and modification times of all files. The contents of the
        files are not read. If the path is in the folder ``root``, the path relative to ``root`` is hashed."""
        files = [file for pattern in self.patterns for file in sorted(self.path.glob(pattern))]
        if not self.patterns and self.path.exists():
            files = [self.path]
        entries = [_place(self.path, root)]
        for file in files:
            try:
                status = file.stat()
            except OSError:  # A link to a missing file or to itself, which the stage reports later.
                status = file.lstat()
            entries.append(f"{file.relative_to(self.path)} {status.st_size} {status.st_mtime_ns}")
        return _digest(entries)


@dataclass(frozen=True)
class Leftovers:
    """Files that a stage may have written with an older key (see :meth:`Stage.key`). The runner removes them before the
    stage starts with a new key.

    Attributes:
        folder: the folder to empty, which may be missing.
        keep: names of files and subfolders to keep, because they belong to other stages.
    """

    folder: Path
    keep: tuple[str, ...] = ()

    def remove(self) -> None:
        """Delete all files and subfolders of ``folder`` except those in ``keep``."""
        if not self.folder.exists():
            return
        for entry in self.folder.iterdir():
            if entry.name in self.keep:
                continue
            if entry.is_dir() and not entry.is_symlink():
                shutil.rmtree(entry)
            else:
                entry.unlink()


@dataclass(frozen=True)
class StageState:
    """Everything on which the result of a stage depends.

    Attributes:
        key: hash of the other attributes.
        settings: the value of each setting as text, by its name. Names of nested settings are joined by dots.
        inputs: the fingerprint of each input, by its path.
        before: the key of each earlier stage on which the stage depends, by its name.
    """

    key: str
    settings: Mapping[str, str]
    inputs: Mapping[str, str]
    before: Mapping[str, str]


@dataclass(frozen=True)
class Stage(Generic[Files, Settings]):
    """One step of the pipeline. A stage is picklable, so a runner can execute it in another process or on another
    machine.

    Attributes:
        name: name of the stage, unique within a graph.
        work: a module-level function that reads and writes ``files`` according to ``settings``. Repeating an
            interrupted call with the same arguments resumes the work.
        files: dataclass with the paths that ``work`` reads and writes.
        settings: dataclass with all parameters that affect the result, apart from the contents of files. They are part
            of the key.
        inputs: artefacts that ``work`` reads. Their fingerprints are part of the key.
        outputs: paths that ``work`` writes. They all exist when the stage has finished.
        leftovers: files to remove before ``work`` starts with a new key.
        after: names of stages that must finish before this stage. Their keys are part of this stage's key.
        is_parallel: whether the stage may run at the same time as other parallel stages that directly precede or follow
            it in the order of execution. A stage never runs at the same time as the stages in its ``after``.
        is_portable: whether the stage can run on a machine that shares no folder with the machine that created the
            stage.
        has_checkpoints: whether the stage writes checkpoints, from which another machine can continue its work.
        expected_s: module-level function that returns the expected duration in seconds, for the plan of ``fourd make``.
            None for stages that take seconds.
        starts_run: whether the stage starts the training in the run folder ``leftovers[0].folder``. The runner may
            instead bring back a run that it kept when an earlier command had other settings.
    """

    name: str
    work: Callable[[Files, Settings, Context], None]
    files: Files
    settings: Settings
    inputs: tuple[Artefact, ...] = ()
    outputs: tuple[Path, ...] = ()
    leftovers: tuple[Leftovers, ...] = ()
    after: tuple[str, ...] = ()
    is_parallel: bool = False
    is_portable: bool = False
    has_checkpoints: bool = False
    starts_run: bool = False
    expected_s: Callable[[Settings, Workload], float] | None = None

    def state(self, keys: Mapping[str, str], root: Path | None = None) -> StageState:
        """Return everything on which the result of the stage depends, in readable form, and its hash.

        The arguments are those of :meth:`key`.
        """
        inputs = [(str(artefact.path), artefact.fingerprint(root)) for artefact in self.inputs]
        before = {name: keys[name] for name in self.after if name in keys}
        parts = [
            self.name,
            json.dumps(asdict(self.settings), sort_keys=True, default=str),
            *(fingerprint for _, fingerprint in inputs),
            *before.values(),
        ]
        return StageState(_digest(parts), self.readable_settings(), dict(inputs), before)

    def readable_settings(self) -> dict[str, str]:
        """Return the value of each setting as text, by its name. Names of nested settings are joined by dots."""
        return dict(_readable(asdict(self.settings)))

    def key(self, keys: Mapping[str, str], root: Path | None = None) -> str:
        """Return a hash of everything on which the result of the stage depends.

        Args:
            keys: maps the name of each earlier stage to its key. Names in ``after`` that are missing in ``keys`` are
                ignored.
            root: folder for intermediate results, or None. Its path may differ between machines, so the key does not
                depend on it.
        """
        return self.state(keys, root).key

    def duration_s(self, workload: Workload) -> float:
        """Return a rough estimate of the duration in seconds, or 0 for a stage that takes seconds."""
        return 0.0 if self.expected_s is None else self.expected_s(self.settings, workload)

    def is_finished(self) -> bool:
        """Return True if all outputs exist."""
        return all(path.exists() for path in self.outputs)

    def run(self, context: Context | None = None) -> None:
        """Execute the work of the stage. If ``context`` is None, the work uses one process and prints nothing."""
        self.work(self.files, self.settings, context or Context())


def _readable(value: Any, name: str = "") -> Iterator[tuple[str, str]]:
    """Yield the dotted name and the text of each setting in nested dictionaries."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _readable(item, f"{name}.{key}" if name else str(key))
    else:
        yield name, _text(value)


def _text(value: Any) -> str:
    if value is None:
        return "not set"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, tuple | list):
        return ", ".join(_text(item) for item in value) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _place(path: Path, root: Path | None) -> str:
    """Return the path relative to ``root`` if it is in the folder ``root``, otherwise the absolute path."""
    absolute = resolved(path)
    if root is not None and absolute.is_relative_to(resolved(root)):
        return absolute.relative_to(resolved(root)).as_posix()
    return str(absolute)


def _digest(parts: list[str]) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]
