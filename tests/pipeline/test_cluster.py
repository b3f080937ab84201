"""Tests of stages on a Ray cluster. The tests that start a cluster need the package ray, and are skipped without it."""

from __future__ import annotations

import importlib.util
import io
import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from rich.console import Console

from fourd.base.errors import UserError
from fourd.base.version import __version__
from fourd.cli.main import main
from fourd.pipeline.cluster import Cluster, Job, join_cluster, run_job
from fourd.pipeline.make import make_scene
from fourd.pipeline.runner import AnyStage
from fourd.pipeline.stage import Context, NoSettings, Stage
from fourd.reconstruction.training.config import SegmentConfig
from fourd.recording.matting.sequence import MatteSettings
from fourd.scene import open_scene
from tests.captures import write_ball_capture
from tests.pipeline.cluster_stages import CounterFiles, die_once, fail, report_process, stop
from tests.pipeline.test_stage import copy_stage
from tests.training.small import SMALL, with_steps

HAS_RAY = importlib.util.find_spec("ray") is not None
needs_ray = pytest.mark.skipif(not HAS_RAY, reason="needs ray (pip install 'fourd[cluster]')")


@pytest.fixture(scope="module")
def cluster() -> Iterator[Cluster]:
    with join_cluster("auto", 1) as joined:
        yield joined


def test_a_job_checks_the_node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a node with another version of fourd, and a node that does not see the shared storage."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setenv("FOURD_THREADS", "1")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "source").write_text("text")
    stage = copy_stage(tmp_path / "source", tmp_path / "a")
    job = Job(stage, 1, tmp_path, __version__)
    older = run_job(replace(job, version="0.0.1"))
    assert older.error == f"expected fourd 0.0.1, got {__version__}; install the same version on all nodes"
    elsewhere = run_job(replace(job, folder=tmp_path / "missing"))
    expected = (
        f"{tmp_path / 'missing'}: expected the working folder of fourd make, got no such folder; mount the storage"
    )
    assert (elsewhere.error or "").startswith(expected)
    assert not (tmp_path / "a").exists()
    assert run_job(job).error is None
    assert (tmp_path / "a" / "copy").read_text() == "text"
    failed = run_job(replace(job, stage=Stage("fail", fail, CounterFiles(tmp_path / "x"), NoSettings())))
    assert failed.error == f"{tmp_path / 'x'}: expected something else"


def test_a_stopped_training_is_no_lost_worker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a stop on the page of a run that is reported as a lost worker, or repeated."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setenv("FOURD_THREADS", "1")
    monkeypatch.chdir(tmp_path)
    stage = Stage("stop", stop, CounterFiles(tmp_path / "x"), NoSettings())
    stopped = run_job(Job(stage, 1, tmp_path, __version__))
    assert stopped.error == "expected a stage that finishes, got one that was stopped; run the command again to resume"


@dataclass(frozen=True)
class FakeRay:
    """A replacement for the module ray. Its cluster has nodes with the given numbers of cores, and None stands for a
    lost node."""

    cores: tuple[int | None, ...]

    def nodes(self) -> list[dict[str, object]]:
        return [
            {"Alive": cores is not None, "Resources": {"CPU": float(cores)} if cores else {}} for cores in self.cores
        ]


def test_a_cluster_without_cores_is_refused() -> None:
    """Catches a range of cores from 1 to 0 in a message, after all nodes but the head were lost."""
    expected = r"--ray: expected a cluster that has nodes with cores, got 1 nodes without cores; add one with ray start"
    with pytest.raises(UserError, match=expected):
        Cluster(FakeRay((0, None)), 1)
    with pytest.raises(UserError, match=r"--ray-cores: expected 1 to 4, the cores of a node, got 5"):
        Cluster(FakeRay((0, 4, 2)), 5)


@pytest.mark.skipif(HAS_RAY, reason="ray is installed here")
def test_a_missing_package_is_named(ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a traceback if the extra is not installed."""
    assert main(["make", str(ball_capture), "-o", str(tmp_path / "scene.4dv"), "--ray", "auto"]) == 2
    line = capsys.readouterr().err
    assert line == "fourd make: --ray: expected the package ray, got none; pip install 'fourd[cluster]'\n"


@needs_ray
def test_a_cluster_that_does_not_start_is_no_internal_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a traceback on a machine that is too busy to start Ray in time."""

    def init(**_: object) -> None:
        raise Exception("The current node timed out during startup.")

    monkeypatch.setattr("ray.init", init)
    with pytest.raises(UserError, match="got 'The current node timed out"), join_cluster("auto", 1):
        pass


@needs_ray
def test_a_killed_worker_is_replaced_and_failures_wait_for_the_others(cluster: Cluster, tmp_path: Path) -> None:
    """Catches a command that fails because a worker is lost, and a failed stage that stops the other stages. Also
    catches a message that does not name the node.
    """
    stages: list[AnyStage] = [
        Stage("bad", fail, CounterFiles(tmp_path / "bad"), NoSettings(), is_parallel=True),
        Stage("killed", die_once, CounterFiles(tmp_path / "count"), NoSettings(), is_parallel=True),
    ]
    text, finished = io.StringIO(), []
    with pytest.raises(UserError, match=r"bad on node .*: .*bad: expected something else$"):
        finished.extend(stage.name for stage in cluster.execute(stages, Context(Console(file=text))))
    assert finished == ["killed"]
    assert (tmp_path / "count").read_text() == "2"
    printed = text.getvalue().splitlines()
    assert printed[0] == "cores 1, threads 1"
    # On a slow machine, the progress is printed as well. The failed stage does not count as finished.
    assert all(line.startswith("stages on the cluster: 1 of 2 after ") for line in printed[1:])


def test_a_job_changes_the_threads_of_a_process_that_has_imported_torch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a process that keeps the number of threads of its first job: torch reads the variable only once."""
    import torch

    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setenv("FOURD_THREADS", "1")
    stage, before = Stage("report", report_process, CounterFiles(tmp_path), NoSettings()), torch.get_num_threads()
    try:
        printed = [run_job(Job(stage, cores, None, __version__)).lines for cores in (3, 1, 2)]
    finally:
        torch.set_num_threads(before)
    assert printed == [(f"{os.getpid()} {cores}",) for cores in (3, 1, 2)]


@needs_ray
def test_segments_share_a_process_and_other_stages_do_not(cluster: Cluster, tmp_path: Path) -> None:
    """Catches a new process for each segment, which needs seconds to import torch, and a process that keeps the memory
    of a stage that uses a whole node.
    """

    def process(name: str, is_parallel: bool) -> str:
        text = io.StringIO()
        stage = Stage(name, report_process, CounterFiles(tmp_path), NoSettings(), is_parallel=is_parallel)
        assert len(list(cluster.execute([stage], Context(Console(file=text))))) == 1
        return text.getvalue().split()[0]

    segments = [process(f"segment {index}", True) for index in range(2)]
    others = [process(f"other {index}", False) for index in range(2)]
    assert segments[0] == segments[1]
    assert others[0] != others[1]


@needs_ray
@pytest.mark.slow
def test_segments_are_trained_on_a_cluster(cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches stages that need the memory of the driver, and relative paths that a worker reads from another folder."""
    write_ball_capture(tmp_path / "capture", frames=12)
    monkeypatch.chdir(tmp_path)
    config = replace(with_steps(SMALL, 3), segments=SegmentConfig(frames=6, overlap=2))
    make_scene(Path("capture"), Path("scene.4dv"), config, MatteSettings(), Context(), cluster=cluster)
    with open_scene(tmp_path / "scene.4dv") as scene:
        assert scene.manifest.frame_numbers == tuple(range(12))
    record = json.loads((tmp_path / "scene.work" / "stages.json").read_text())["stages"]
    assert {"train 000", "train 001", "train 002", "bake"} <= record.keys()


@needs_ray
@pytest.mark.slow
def test_an_address_that_nobody_answers_is_refused() -> None:
    """Catches a traceback of Ray, and a command that waits forever."""
    message = r"--ray: expected a Ray cluster at 127.0.0.1:1, got"
    with pytest.raises(UserError, match=message), join_cluster("127.0.0.1:1", 1):
        pass
