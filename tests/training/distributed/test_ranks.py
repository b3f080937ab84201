"""Tests of training by several ranks, each of which is a process on this machine."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from fourd.base.errors import UserError
from fourd.cli.main import main
from fourd.pipeline.make import create_run
from fourd.pipeline.stages.train import require_divisible, require_frames
from fourd.reconstruction.training.distributed.process_group import ALONE, ProcessGroup, join_process_group
from fourd.reconstruction.training.loop import Trainer
from fourd.reconstruction.training.metrics_log import NoLog
from fourd.reconstruction.training.run import load_run, open_run
from fourd.reconstruction.training.schedule import StepSampler
from tests.processes.forked import run_together
from tests.training.distributed.workers import frame_gradients, record_gradients, small_model
from tests.training.small import SMALL, quiet, trained_run

ROOT = Path(__file__).resolve().parents[3]
CONFIG = replace(SMALL, max_steps=2)
OVERLAY = "points: 1500\nlayers: 8\nmodel: {hidden: 16, planes: {levels: 2, base_resolution: 16}}\n"


def start_ranks(commands: list[list[str]], folder: Path) -> list[subprocess.CompletedProcess[str]]:
    """Run one command per rank, as torchrun does, and wait for all of them. The output goes to ``folder``."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    base = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "WORLD_SIZE": str(len(commands))}
    ranks = [base | {"RANK": str(rank), "LOCAL_RANK": str(rank)} for rank in range(len(commands))]
    return run_together(commands, folder, ranks)


@pytest.fixture(scope="module")
def gradients(ball_capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a new run, and the gradients that two ranks recorded."""
    folder = tmp_path_factory.mktemp("ranks")
    create_run(ball_capture, folder / "run", CONFIG)
    for result in start_ranks([["tests.training.distributed.workers", str(folder)]] * 2, folder):
        assert result.returncode == 0, result.stderr
    return folder


def relative_difference(got: torch.Tensor, expected: torch.Tensor) -> float:
    return float((got - expected).norm() / expected.norm().clamp(min=1e-300))


def test_gradients_in_float64_are_those_of_one_process(gradients: Path) -> None:
    """Catches gradients that are summed instead of averaged, and parameters whose order differs between ranks. Also
    catches gradients that are lost because one rank has no gradient.
    """
    model, expected = small_model(), dict[str, torch.Tensor]()
    for frame in range(2):
        frame_gradients(model, frame)
        for name, value in model.named_parameters():
            if value.grad is not None:
                expected[name] = expected.get(name, torch.zeros_like(value)) + value.grad / 2
    for rank in range(2):
        each = load_file(gradients / f"average-{rank}.safetensors")
        assert each.keys() == expected.keys()
        assert max(relative_difference(each[name], expected[name]) for name in expected) < 1e-6


def test_a_training_step_has_the_mean_gradient_of_its_views(gradients: Path, tmp_path: Path) -> None:
    """Catches ranks that train the same view, and networks that differ between the ranks."""
    parts = []
    for rank in range(2):
        run = open_run(gradients / "run")
        trainer = Trainer(run, None, quiet(), CONFIG)
        cameras, frames, views = run.capture.cameras, run.capture.frame_count, run.training
        trainer.sampler = StepSampler(CONFIG, cameras, views, frames, run.focus, ProcessGroup(rank, 2))
        record_gradients(trainer, tmp_path / "alone.safetensors")
        trainer._step(NoLog())
        parts.append(load_file(tmp_path / "alone.safetensors"))
    for rank in range(2):
        for name, value in load_file(gradients / f"step-{rank}.safetensors").items():
            expected = (parts[0][name].double() + parts[1][name].double()) / 2
            # float32 sums depend on the number of threads
            assert relative_difference(value.double(), expected) < 1e-5, name
    assert not torch.equal(parts[0]["0"], parts[1]["0"])


def test_each_rank_samples_all_views_of_its_own_frames(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a frame that two ranks train, and views that are never sampled. Also catches a run with one rank whose
    samples differ from the samples of training without ranks.
    """
    run = create_run(ball_capture, tmp_path / "run", SMALL)
    views, frames = len(run.training), run.capture.frame_count

    def sampled(group: ProcessGroup, steps: int) -> list[tuple[int, int]]:
        sampler = StepSampler(SMALL, run.capture.cameras, run.training, frames, run.focus, group)
        samples = [sampler.sample(step) for step in range(0, steps * group.size, group.size)]
        return [(sample.frame, sample.target) for sample in samples]

    for rank, own in enumerate([(0, 2), (1,)]):
        expected = sorted((frame, target) for frame in own for target in run.training)
        assert sorted(sampled(ProcessGroup(rank, 2), len(own) * views)) == expected
    assert sorted(sampled(ALONE, frames * views)) == sorted((f, t) for f in range(frames) for t in run.training)


def torchrun(ranks: int, *words: str) -> subprocess.CompletedProcess[str]:
    command = ["torch.distributed.run", "--standalone", "--nproc-per-node", str(ranks), "-m", "fourd", *words]
    environment = {name: value for name, value in os.environ.items() if name not in ("RANK", "WORLD_SIZE")}
    return subprocess.run(
        [sys.executable, "-m", *command], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=300
    )


def test_a_run_resumes_with_another_number_of_ranks(ball_capture: Path, tmp_path: Path) -> None:
    """Catches points that only one rank has, and a checkpoint that another number of ranks cannot read. Also catches
    steps that are counted once per rank or not at all."""
    overlay, run = tmp_path / "small.yaml", tmp_path / "run"
    overlay.write_text(OVERLAY)
    words = ["train", str(ball_capture), "-o", str(run)]
    first = torchrun(2, *words, "--config", str(overlay), "--test-views", "03", "--max-steps", "8")
    assert first.returncode == 0, first.stderr
    assert first.stdout.count("8 steps") == 1, "only rank 0 prints"
    trained = load_run(run)
    assert trained.step == 8
    ages = [int(trained.frames.get(frame).age) for frame in range(3)]
    assert [ages[0] + ages[2], ages[1]] == [4, 4], "rank 0 owns the frames 0 and 2"
    assert main(["verify", str(run)]) == 0
    assert main([*words, "--resume", "--max-steps", "11"]) == 0
    trained = load_run(run)
    assert trained.step == 11
    assert sum(int(trained.frames.get(frame).age) for frame in range(3)) == 11


@pytest.mark.slow
def test_a_run_of_one_rank_resumes_with_three(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a run that cannot be resumed with another number of ranks, and steps beyond the budget."""
    trained_run(ball_capture, tmp_path / "run", replace(SMALL, max_steps=4))
    again = torchrun(3, "train", str(ball_capture), "-o", str(tmp_path / "run"), "--resume", "--max-steps", "9")
    assert again.returncode == 0, again.stderr
    trained = load_run(tmp_path / "run")
    assert trained.step == 10
    assert sum(int(trained.frames.get(frame).age) for frame in range(3)) == 10


def test_ranks_with_different_configs_are_refused(ball_capture: Path, tmp_path: Path) -> None:
    """Catches ranks that wait for each other forever, and a message that does not say which rank to change."""
    words = ["fourd", "train", str(ball_capture), "-o", str(tmp_path / "run"), "--max-steps", "4", "--points"]
    results = start_ranks([[*words, "1500"], [*words, "1600"]], tmp_path)
    assert [result.returncode for result in results] == [2, 2]
    assert results[1].stderr == ""
    line = results[0].stderr
    assert line.startswith("fourd train: rank 1 on ")
    assert "expected the config of rank 0 ('points: 1500'), got 'points: 1600'; start all ranks with the same" in line
    assert line.count("\n") == 1
    assert not (tmp_path / "run").exists()


def test_work_that_ranks_cannot_share_is_refused() -> None:
    """Catches a rank without frames, ranks that train separate copies of the background, and a message that every rank
    prints.
    """
    two = ProcessGroup(0, 2)
    with pytest.raises(
        UserError, match=r"torchrun: expected at most one rank per frame, got 2 ranks and 1 frames; set"
    ):
        require_frames(1, two)
    with pytest.raises(UserError, match=r"torchrun: expected --scene object with several ranks, got --scene full and"):
        require_divisible(replace(SMALL, scene="full"), two)
    with pytest.raises(SystemExit):
        require_frames(1, ProcessGroup(1, 2))
    require_divisible(replace(SMALL, scene="full"), ALONE)


def test_an_address_that_nobody_answers_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a rank that waits forever for a machine that was not started."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    for name, value in {"RANK": "1", "WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port)}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr("fourd.reconstruction.training.distributed.process_group.JOIN_SECONDS", 0.5)
    message = rf"127.0.0.1:{port}: expected rank 0 at this address, got no connection"
    with pytest.raises(UserError, match=message), join_process_group():
        pass
