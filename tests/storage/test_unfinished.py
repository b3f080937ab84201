"""Tests of uploads of a stage that is still running, with which another machine continues its work."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import pytest
from rich.console import Console

from fourd.base.errors import UserError
from fourd.base.storage import StorageUrl, find_objects
from fourd.pipeline.stage import Context, Leftovers, NoSettings, Stage
from fourd.pipeline.stored.cache import CACHE_VARIABLE, cache_folder
from fourd.pipeline.stored.manifest import Manifest
from fourd.pipeline.stored.unfinished import SUFFIX, _checkpoints
from fourd.pipeline.stored.unit import UnitFiles, unit_stage
from fourd.pipeline.stored.work_store import WorkStore
from tests.captures import write_ball_capture
from tests.storage.s3_server import Bucket, put_folder
from tests.storage.test_work import Machines as CommandMachines

NAME, LAST_STEP, PATIENCE_S = "train 000", 4, 60.0
UPLOADED = NAME + SUFFIX

LOST_AFTER_UPLOAD = """
import os, signal, sys
from fourd.cli.main import main
from fourd.pipeline.stored import unit
from fourd.pipeline.stored.unfinished import Unfinished

unit.UPLOAD_SECONDS, upload = 0.05, Unfinished._upload

def upload_and_die(self, states, log):
    if upload(self, states, log):
        os.kill(os.getpid(), signal.SIGKILL)

Unfinished._upload = upload_and_die
main(sys.argv[1:])
"""


@dataclass(frozen=True)
class CountFiles:
    """The folder of the steps, and the step after which the machine is lost once its checkpoint was uploaded. If the
    stage starts from this step, the machine is lost at once."""

    run: Path
    store: WorkStore
    lost_after: int


def count(files: CountFiles, settings: NoSettings, context: Context) -> None:
    """Write one checkpoint per step, and replace the previous one. While a checkpoint waits for its upload, the metrics
    grow."""
    folder = files.run / "checkpoints"
    folder.mkdir(parents=True, exist_ok=True)
    start = max((int(path.name) for path in folder.iterdir()), default=0)
    context.log(f"from step {start}")
    if start and start == files.lost_after:
        raise KeyboardInterrupt
    for step in range(start + 1, LAST_STEP + 1):
        (folder / str(step)).write_text("x" * step)
        (folder / str(step - 1)).unlink(missing_ok=True)
        if step == files.lost_after:
            _wait_for(files, step)
            raise KeyboardInterrupt


def _wait_for(files: CountFiles, step: int) -> None:
    """Return when the checkpoint of the step is uploaded. The metrics grow during the upload."""
    end = time.monotonic() + PATIENCE_S
    with (files.run / "metrics.jsonl").open("a") as metrics:
        while time.monotonic() < end:
            metrics.write("one more line\n")
            metrics.flush()
            manifest = files.store.read(UPLOADED)
            if manifest is not None and f"run/checkpoints/{step}" in manifest.files:
                return
            time.sleep(0.01)
    raise AssertionError("nothing was uploaded")


class Machines:
    """Machines that share only a bucket."""

    def __init__(self, bucket: Bucket, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.store = WorkStore(StorageUrl(f"{bucket.url}/work"))
        self.is_parallel = True
        self._folder = folder
        self._monkeypatch = monkeypatch
        self.store.open()

    def execute(self, machine: str, key: str = "key", lost_after: int = 0) -> str:
        """Execute the stage on a machine, and return the printed lines."""
        self._monkeypatch.setenv(CACHE_VARIABLE, str(self._folder / machine))
        root = cache_folder(self.store.url)
        stage = Stage(
            NAME,
            count,
            CountFiles(root / "run", self.store, lost_after),
            NoSettings(),
            leftovers=(Leftovers(root / "run"),),
            is_parallel=self.is_parallel,
            has_checkpoints=True,
        )
        text = io.StringIO()
        unit = unit_stage(UnitFiles(stage, root, self.store, self._folder, ()), key)
        unit.run(Context(Console(file=text, width=1000)))
        return text.getvalue()

    def lose(self, machine: str, after: int) -> None:
        """Lose a machine after a step whose checkpoint was uploaded."""
        with pytest.raises(KeyboardInterrupt):
            self.execute(machine, lost_after=after)


@pytest.fixture
def machines(bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Machines:
    monkeypatch.setattr("fourd.pipeline.stored.unit.UPLOAD_SECONDS", 0.05)
    return Machines(bucket, tmp_path, monkeypatch)


def test_another_machine_continues_from_the_last_upload(machines: Machines) -> None:
    """Catches a segment that starts again from step 0 because its machine was lost, and an upload of a file that grows:
    its object would not have the size in the manifest.
    """
    machines.lose("first", after=2)
    assert UPLOADED in machines.store.open(), "the upload is complete"
    machines.lose("second", after=3)
    assert machines.execute("third") == "from step 3\n"
    manifest = machines.store.read(NAME)
    assert manifest is not None
    assert set(manifest.files) == {f"run/checkpoints/{LAST_STEP}", "run/metrics.jsonl"}
    assert machines.store.read(UPLOADED) is None
    kept = [item.key for item in find_objects(machines.store.url) if "unfinished" in item.key]
    assert not kept, "the uploads of the unfinished stage are removed"


@pytest.mark.parametrize("is_parallel", [True, False])
def test_the_copied_checkpoints_belong_to_the_stage(machines: Machines, is_parallel: bool) -> None:
    """Catches a second start on the same machine that removes the copied checkpoints as files of another stage."""
    machines.is_parallel = is_parallel
    machines.lose("first", after=2)
    machines.lose("second", after=2)
    assert machines.execute("second") == "from step 2\n"


def test_an_upload_with_other_settings_is_not_used(machines: Machines) -> None:
    """Catches a training that continues from the checkpoints of another config."""
    machines.lose("first", after=2)
    assert machines.execute("second", key="other") == "from step 0\n"


def test_a_stage_continues_if_uploads_fail(machines: Machines, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a training of hours that a short failure of the store ends. An upload that cannot be copied also must not
    end the stage.
    """
    machines.lose("first", after=2)
    publish, failures = WorkStore.publish, list[str]()

    def fail_once(store: WorkStore, manifest: Manifest, *rest: object) -> None:
        if not failures:
            failures.append(manifest.name)
            raise UserError("s3://bucket: expected an answer, got none")
        publish(store, manifest, *rest)  # type: ignore[arg-type]

    def refuse(store: WorkStore, *rest: object) -> None:
        raise UserError("s3://bucket: expected an object, got none")

    with monkeypatch.context() as broken:
        broken.setattr(WorkStore, "publish", fail_once)
        broken.setattr(WorkStore, "download", refuse)
        with pytest.raises(KeyboardInterrupt):
            machines.execute("second", lost_after=3)
    assert failures == [UPLOADED]
    assert machines.execute("third") == "from step 3\n"


def test_a_checkpoint_counts_when_it_is_complete() -> None:
    """Catches an upload of a checkpoint whose points are written but whose model is not. If the machine is then lost,
    another machine starts from the beginning."""
    points = {"run/checkpoints/0000020.points/000000.safetensors": "a"}
    model = {"run/checkpoints/0000020.safetensors": "b"}
    assert _checkpoints(points) == {}
    assert _checkpoints(points | model) == model


@pytest.mark.slow
def test_a_training_continues_on_another_machine(
    bucket: Bucket, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches uploads of a real training that lack a file, so that the scene differs from that of one machine."""
    source = write_ball_capture(tmp_path / "ball", cameras=4, frames=3, size=48)
    put_folder(bucket.files, source, f"{bucket.name}/ball")
    machines = CommandMachines(bucket, tmp_path, monkeypatch)
    options = ("--max-steps", 60, "--set", "checkpoint_steps=20")
    first = machines.enter("first")
    words = machines.words(f"{bucket.url}/ball", "scene.4dv", *options)
    lost = subprocess.run([sys.executable, "-c", LOST_AFTER_UPLOAD, *words], env={**os.environ})
    assert lost.returncode == -signal.SIGKILL
    second = machines.enter("second")
    machines.make(f"{bucket.url}/ball", "scene.4dv", *options)
    # The times in the metrics of two trainings differ, so equal lines are lines of the same training.
    metrics = [next(folder.glob("cache/work/*/run/metrics.jsonl")).read_text() for folder in (first, second)]
    assert metrics[0].splitlines()[0] == metrics[1].splitlines()[0]
    assert len(metrics[1].splitlines()) == 6
    machines.work = StorageUrl(f"{bucket.url}/other")
    other = machines.enter("other")
    machines.make(f"{bucket.url}/ball", "scene.4dv", *options)
    assert (second / "scene.4dv").read_bytes() == (other / "scene.4dv").read_bytes()
