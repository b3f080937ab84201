"""The runner executes stages, skips stages that are up to date, and resumes interrupted stages."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fourd.base.storage import Location
from fourd.pipeline.stage import Context, Stage
from fourd.pipeline.work.folder import WorkFolder

if TYPE_CHECKING:
    # StoredResults is imported only for type checkers, because it imports the packages for training, and the runner
    # must also run without them.
    from fourd.pipeline.stored.results import StoredResults

AnyStage = Stage[Any, Any]
Execute = Callable[[Sequence[AnyStage], Context], Iterator[AnyStage]]
"""Function that runs the work of stages that do not depend on each other, and yields each stage when its outputs are
written."""


def run_here(stages: Sequence[AnyStage], context: Context) -> Iterator[AnyStage]:
    """Run the work of the stages in this process, one after another."""
    for stage in stages:
        stage.run(context)
        yield stage


class Runner:
    """Runs stages in a given order.

    If a record file is given, the runner prints the state of each stage. It skips a stage if its outputs exist and its
    key (see :meth:`Stage.key`) is the same as in the record file. Before it starts a stage whose key has changed, it
    prints what has changed, and removes the files that were written with the old key. A trained run is not removed, but
    renamed; see :mod:`fourd.pipeline.work.folder`. Without a record file, the runner executes every stage and prints
    nothing; the stages themselves detect and keep finished files.
    """

    def __init__(
        self,
        context: Context,
        record: Path | None = None,
        execute: Execute = run_here,
        *,
        is_parallel: bool = False,
        stored: StoredResults | None = None,
        force: bool = False,
    ) -> None:
        """Create a runner.

        Args:
            context: console, and number of processes for the stages' work.
            record: JSON file in the folder for intermediate results. It has the key and the settings of each started
                and each finished stage, and is written atomically after each change.
            execute: function that runs the work of stages, for example in other processes or on a cluster.
            is_parallel: whether ``execute`` runs several stages at the same time.
            stored: results in an object store, which replace the record file and the local results.
            force: whether to remove trained runs whose settings have changed, instead of keeping them.
        """
        self._context = context
        self._execute = execute if stored is None else stored.execute(execute)
        self._stored = stored
        self._is_parallel = is_parallel
        self._folder = None if record is None else WorkFolder(record, context.log, force=force)
        self._keys: dict[str, str] = {}

    @property
    def is_stored(self) -> bool:
        """Whether the results are in an object store."""
        return self._stored is not None

    def claim(self, scene: Location) -> None:
        """Record that the folder for intermediate results belongs to ``scene``. See :meth:`WorkFolder.claim`."""
        if self._folder is not None:
            self._folder.claim(scene)

    def run(self, stages: Sequence[AnyStage]) -> None:
        """Run ``stages`` in the given order. Each stage must come after the stages that it depends on."""
        for group in _split(stages) if self._is_parallel else [[stage] for stage in stages]:
            due = [stage for stage in group if self._start(stage, stages)]
            for stage in self._execute(due, self._context) if due else ():
                if self._folder is not None:
                    self._folder.finish(stage, self._keys[stage.name])
                self._report(f"{stage.name}: finished{self._result(stage)}")
            if self._stored is not None:
                # The results are copied to this machine, because the next stages and their keys depend on these files.
                self._stored.copy()

    def _start(self, stage: AnyStage, stages: Sequence[AnyStage]) -> bool:
        """Return whether the work of the stage must run. If it must, first remove or keep the files that were written
        with an older key."""
        if self._stored is not None:
            key = self._keys[stage.name] = stage.key(self._keys, self._stored.root)
            # The machine that runs the work removes the files that were written with an older key.
            is_due = not self._stored.is_finished(stage, key)
        elif self._folder is not None:
            done, later = list(self._keys), stages[list(stages).index(stage) + 1 :]
            state = stage.state(self._keys)
            self._keys[stage.name] = state.key
            is_due = self._folder.start(stage, state, done, later)
        else:
            self._keys[stage.name] = stage.key(self._keys)
            is_due = True
        if is_due:
            self._report(f"{stage.name}: running")
        else:
            self._report(f"{stage.name}: up to date{self._result(stage)}")
        return is_due

    def _result(self, stage: AnyStage) -> str:
        return f" ({stage.outputs[0]})" if stage.outputs and self._stored is None else ""

    def _report(self, line: str) -> None:
        if self._folder is not None or self._stored is not None:
            self._context.console.print(line, soft_wrap=True, markup=False)


def _split(stages: Sequence[AnyStage]) -> list[list[AnyStage]]:
    """Split stages into groups of consecutive stages that can run at the same time."""
    groups: list[list[AnyStage]] = []
    for stage in stages:
        before = groups[-1] if groups else []
        names = {other.name for other in before}
        if before and stage.is_parallel and before[0].is_parallel and names.isdisjoint(stage.after):
            before.append(stage)
        else:
            groups.append([stage])
    return groups
