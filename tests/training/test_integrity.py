"""Digests of checkpoints and points, and fourd verify."""

from __future__ import annotations

import os
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from fourd.base.errors import UserError
from fourd.cli.main import main
from fourd.reconstruction.training.checkpoints import _checksum, load_checkpoint, verify_checkpoint
from fourd.reconstruction.training.loop import Trainer
from fourd.reconstruction.training.run import Run, load_run, open_run
from fourd.reconstruction.training.run_layout import checkpoint_files, points_folder
from tests.training.small import quiet, train, trained_run, with_steps


@pytest.fixture(scope="module")
def trained(ball_capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Run:
    return trained_run(ball_capture, tmp_path_factory.mktemp("whole") / "run")


@pytest.fixture
def run(trained: Run, tmp_path: Path) -> Run:
    """A copy of the run, with checkpoints of the steps 3 and 6."""
    shutil.copytree(trained.folder, tmp_path / "run")
    return open_run(tmp_path / "run")


def flip_bit(path: Path, rng: np.random.Generator) -> None:
    content = bytearray(path.read_bytes())
    content[-1 - int(rng.integers(0, len(content) // 4))] ^= 1 << int(rng.integers(0, 8))
    path.write_bytes(content)


@pytest.mark.parametrize("damage", ["flip", "cut", "remove", "pipe"])
def test_damaged_points_lead_to_the_older_checkpoint(
    run: Run, damage: str, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches damaged points that are rendered, and a traceback although an older checkpoint is intact."""
    older, newer = checkpoint_files(run.checkpoints)
    assert verify_checkpoint(newer) == 1 + run.capture.frame_count
    assert main(["verify", str(run.folder)]) == 0
    assert f"{run.folder}: whole; 2 checkpoints" in capsys.readouterr().out
    points = sorted(points_folder(newer).iterdir())[1]
    if damage == "flip":
        flip_bit(points, rng)
    elif damage == "cut":
        points.write_bytes(points.read_bytes()[:-40])
    else:
        points.unlink()
        if damage == "pipe":
            os.mkfifo(points)
    assert load_run(run.folder).step == int(older.stem) == 3
    assert main(["verify", str(run.folder)]) == 2
    captured = capsys.readouterr()
    assert captured.err.startswith(f"fourd verify: {points}: expected ")
    assert f"{older}: whole" in captured.out
    # A resumed training also starts from the older checkpoint, and writes an intact checkpoint at the end.
    train(run, with_steps(run.config.train, 6))
    assert load_run(run.folder).step == 6


def test_a_changed_state_is_refused(run: Run) -> None:
    """Catches a checkpoint that is accepted although its step or state was altered, because its tensors are intact."""
    path = checkpoint_files(run.checkpoints)[-1]
    with safe_open(path, framework="pt") as stream:
        header = stream.metadata()
    for name, value in (("step", "7"), ("state", '{"seconds": 0.0, "psnr": 1.0}'), ("points", "{}")):
        save_file(load_file(path), path.with_name("altered"), metadata={**header, name: value})
        with pytest.raises(UserError, match="expected unaltered contents"):
            load_checkpoint(path.with_name("altered"))


def test_checkpoints_without_digests_still_load(run: Run) -> None:
    """Catches a run of an older version of fourd that cannot be opened, or that is opened although points are
    missing."""
    newer = checkpoint_files(run.checkpoints)[-1]
    tensors = load_file(newer)
    with safe_open(newer, framework="pt") as stream:
        header = {name: stream.metadata()[name] for name in ("format", "step", "state")}
    save_file(tensors, newer, metadata={**header, "crc32": str(_checksum(tensors))})
    assert verify_checkpoint(newer) == 1
    trained = load_run(run.folder)
    assert trained.step == 6
    points = points_folder(newer) / "000001.safetensors"
    points.write_bytes(points.read_bytes()[:-40])
    with pytest.raises(UserError, match=r"000001\.safetensors: expected the points of a checkpoint"):
        trained.frames.get(1)


def test_an_interrupt_is_taken_after_a_whole_step(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a checkpoint that is written in the middle of a step. Training resumed from it would not give the same
    bits as uninterrupted training.
    """
    unbroken = {path.name: path.read_bytes() for path in points_folder(checkpoint_files(run.checkpoints)[-1]).iterdir()}
    for path in checkpoint_files(run.checkpoints):
        path.unlink()
    config = replace(run.config.train, checkpoint_steps=100)
    trainer = Trainer(run, None, quiet(), config)
    step = trainer.stepper.step

    def interrupted(*words: object) -> object:
        if words[-1] == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return step(*words)  # type: ignore[arg-type]

    monkeypatch.setattr(trainer.stepper, "step", interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            trainer.train()
    finally:
        signal.signal(signal.SIGINT, before)
    assert [path.stem for path in checkpoint_files(run.checkpoints)] == ["00000004"]
    train(run, config)
    resumed = points_folder(checkpoint_files(run.checkpoints)[-1])
    assert {path.name: path.read_bytes() for path in resumed.iterdir()} == unbroken


def test_a_step_that_another_thread_prepares_has_the_same_bits(
    trained: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a step that is prepared from points, images or a sample that another step still changes."""
    monkeypatch.setenv("FOURD_THREADS", "2")
    shutil.copytree(trained.folder, tmp_path / "run", ignore=shutil.ignore_patterns("checkpoints"))
    run = open_run(tmp_path / "run")
    trainer = Trainer(run, None, quiet(), trained.config.train)
    ahead, take = [], trainer.preparation.take
    monkeypatch.setattr(trainer.preparation, "take", lambda sample: ahead.append(take(sample)) or ahead[-1])
    trainer.train()
    assert any(each is not None for each in ahead)
    for alone, together in zip(checkpoint_files(trained.checkpoints), checkpoint_files(run.checkpoints), strict=True):
        whole, again = (load_file(path) for path in (alone, together))
        assert all(torch.equal(whole[name], again[name]) for name in whole)
        for path in points_folder(alone).iterdir():
            assert (points_folder(together) / path.name).read_bytes() == path.read_bytes()
