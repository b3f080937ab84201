"""Keeps track of the stages whose results are in an object store. Only the process that starts the stages uses this
module, not the processes that run them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from fourd.base.errors import UserError
from fourd.base.storage import Location, StorageUrl, list_objects
from fourd.pipeline.fetch import FetchSettings
from fourd.pipeline.stage import Context, StageState
from fourd.pipeline.stored.cache import Cache, cache_folder
from fourd.pipeline.stored.manifest import Manifest
from fourd.pipeline.stored.unfinished import SUFFIX
from fourd.pipeline.stored.unit import AnyStage, UnitFiles, fetch_source, unit_stage
from fourd.pipeline.stored.work_store import WorkStore
from fourd.pipeline.work.folder import RUN, TRAINING
from fourd.pipeline.work.record import StageEntry, shown_changes
from fourd.reconstruction.training.run_layout import CHECKPOINTS

Execute = Callable[[Sequence[AnyStage], Context], Iterator[AnyStage]]


class StoredResults:
    """Finds finished stages in an object store, runs stages, and copies their results to this machine."""

    def __init__(self, url: StorageUrl, source: Location, context: Context, *, force: bool = False) -> None:
        """Read the manifests at ``url``. If ``force`` is true, trained runs whose settings have changed are replaced
        instead of being an error.

        Raises:
            UserError: if a store refuses a request, or if the folder ``url`` has objects but was not created by ``fourd
                make``.
        """
        self._store = WorkStore(url)
        self._cache = Cache(cache_folder(url))
        self._context = context
        self._force = force
        self._is_replacing = False
        if isinstance(source, StorageUrl):
            self._source: FetchSettings | Path = FetchSettings(str(source), list_objects(source).version)
        else:
            self._source = source.absolute()
        self._manifests = self._store.open()
        self._stages: dict[str, AnyStage] = {}
        self._keys: dict[str, str] = {}

    @property
    def root(self) -> Path:
        """The folder of the local copy, in which stages read and write their files."""
        return self._cache.root

    def source(self) -> Path:
        """Return the local path of the source. If it is at a URL, first copy it to this machine."""
        if isinstance(self._source, Path):
            return self._source
        return fetch_source(self._source, self.root, self._context.track)

    def is_finished(self, stage: AnyStage, key: str) -> bool:
        """Return True if the results of ``stage`` for the key ``key`` are complete. Call this method for all stages, in
        the order in which they run, because it also records the stage and this order.

        Raises:
            UserError: if the stage would replace a trained run because settings have changed, without ``force``.
        """
        self._stages[stage.name], self._keys[stage.name] = stage, key
        manifest = self._manifests.get(stage.name)
        outside = [path for path in stage.outputs if not path.is_relative_to(self.root)]
        if manifest is not None and manifest.key == key and all(path.exists() for path in outside):
            return True
        self._check_training(stage, key, manifest)
        return False

    def _check_training(self, stage: AnyStage, key: str, manifest: Manifest | None) -> None:
        """Raise UserError if ``stage`` would replace a trained run; see :meth:`is_finished`."""
        trained = {name: each for name, each in self._manifests.items() if name.split()[0] == TRAINING}
        if manifest is None or manifest.key == key or not self._writes_run(stage):
            # A run with segments is trained by other stages than a run without.
            trained = {
                name: each
                for name, each in trained.items()
                if stage.starts_run and name.removesuffix(SUFFIX).count(" ") == (stage.name == TRAINING)
            }
        if not trained:
            return
        names = [Path(path) for each in trained.values() for path in each.files]
        saved = [path.stem for path in names if path.parent.name == CHECKPOINTS and path.stem.isdecimal()]
        steps = max(map(int, saved), default=0)
        run = f"the {'un' if all(name.endswith(SUFFIX) for name in trained) else ''}finished run of {steps:,} steps"
        if not self._force:
            entry = StageEntry(state=StageState("", manifest.settings if manifest else {}, {}, {}))
            changes = shown_changes(entry.changed_settings(stage.readable_settings()) or ["other inputs or segments"])
            raise UserError(
                f"{self._store.url}: expected the settings of {run} in this folder, got others ({changes}); name "
                "another --work to keep the run, or add --force to replace it"
            )
        if not self._is_replacing:
            self._context.log(f"{self._store.url}: {run} is replaced, because of --force")
        self._is_replacing = True

    def _writes_run(self, stage: AnyStage) -> bool:
        return any(each.folder.is_relative_to(self.root / RUN) for each in stage.leftovers)

    def copy(self) -> None:
        """Copy the results of the finished stages to this machine, except the results of segments."""
        found = [self._manifests[name] for name, stage in self._stages.items() if self._is_read_here(name, stage)]
        with self._cache.locked():
            self._cache.copy(self._store, found, self._context.track)

    def execute(self, inner: Execute) -> Execute:
        """Return a function that passes stages to ``inner``, which runs them. The machines that run the stages exchange
        files through the store."""

        def run(stages: Sequence[AnyStage], context: Context) -> Iterator[AnyStage]:
            by_name = {stage.name: stage for stage in stages}
            for unit in inner([self._unit(stage) for stage in stages], context):
                manifest = self._store.read(unit.name)
                if manifest is None or manifest.key != self._keys[unit.name]:
                    raise UserError(
                        f"{self._store.url}: expected the results of stage {unit.name}, got those of another command; "
                        "run one fourd make at a time with this --work"
                    )
                self._manifests[unit.name] = manifest
                yield by_name[unit.name]

        return run

    def remove_others(self) -> None:
        """Remove the results of stages that this command did not need, such as surplus segments if an earlier command
        divided the frames into more segments."""
        for name, manifest in list(self._manifests.items()):
            if name not in self._stages:
                self._store.remove(manifest)
        with self._cache.locked():
            self._cache.remove_others(self._stages.keys())

    def _unit(self, stage: AnyStage) -> AnyStage:
        needed = self._needed(stage)
        needs = tuple((name, self._keys[name]) for name in self._stages if name in needed)
        return unit_stage(UnitFiles(stage, self.root, self._store, self._source, needs), self._keys[stage.name])

    def _needed(self, stage: AnyStage) -> set[str]:
        """Return the names of the earlier stages whose results a stage reads: those that are not parallel, and those
        that ``after`` names directly or indirectly."""
        names, found = list(stage.after), set[str]()
        while names:
            name = names.pop()
            if name in self._stages and name not in found:
                found.add(name)
                names += self._stages[name].after
        earlier = list(self._stages)[: list(self._stages).index(stage.name)]
        return {name for name in earlier if name in found or not self._stages[name].is_parallel}

    def _is_read_here(self, name: str, stage: AnyStage) -> bool:
        manifest = self._manifests.get(name)
        return manifest is not None and manifest.key == self._keys[name] and not stage.is_parallel
