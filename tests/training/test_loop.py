"""Training runs: checkpoints, resuming and errors."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from fourd.base.errors import UserError
from fourd.base.formats.ply import read_ply, write_ply
from fourd.pipeline.make import create_run
from fourd.reconstruction.training.loop import Trainer
from fourd.reconstruction.training.losses.mask import MaskTerm
from fourd.reconstruction.training.losses.term import RenderedStep
from fourd.reconstruction.training.run import load_run, open_run
from fourd.reconstruction.training.step import StepResult
from tests.training.small import SMALL, full_config, quiet, train, trained_run, with_steps


def checkpoint_tensors(run: Path, step: int) -> dict[str, torch.Tensor]:
    """All tensors of a checkpoint: the models, the optimizer state, and the points of all frames."""
    base = run / "checkpoints" / f"{step:08d}"
    tensors = load_file(base.with_suffix(".safetensors"))
    for path in sorted(base.with_suffix(".points").glob("*.safetensors")):
        tensors |= {f"{path.stem}.{name}": value for name, value in load_file(path).items()}
    return tensors


@pytest.mark.parametrize("scene", ["object", "full", "shadow"])
def test_a_resumed_run_equals_an_uninterrupted_one(
    scene: str, ball_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches checkpoints in which Adam's moments, step counts of points, radii, or generator states are missing."""
    full = full_config(tmp_path / "shell.ply", shadow=scene == "shadow")
    config = replace(SMALL if scene == "object" else full, max_steps=9)
    uninterrupted = create_run(ball_capture, tmp_path / "whole", config)
    train(uninterrupted, config)
    interrupted = create_run(ball_capture, tmp_path / "broken", config)

    trainer = Trainer(interrupted, None, quiet(), config)
    original_step = trainer.stepper.step

    def step_until_five(*arguments: Any) -> StepResult:
        if arguments[-1] == 5:
            raise InterruptedError
        return original_step(*arguments)

    monkeypatch.setattr(trainer.stepper, "step", step_until_five)
    with pytest.raises(InterruptedError):
        trainer.train()
    train(open_run(tmp_path / "broken"), config)
    expected, got = checkpoint_tensors(tmp_path / "whole", 9), checkpoint_tensors(tmp_path / "broken", 9)
    assert expected.keys() == got.keys()
    different = [name for name in expected if not torch.equal(expected[name], got[name])]
    assert not different


def test_a_loss_that_is_not_finite_stops_training(
    ball_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches training that continues with NaN parameters, and an intact checkpoint that is overwritten with NaN."""
    run = create_run(ball_capture, tmp_path / "run", SMALL)
    value = MaskTerm.value

    def poisoned(self: MaskTerm, step: RenderedStep) -> torch.Tensor:
        return value(self, step) * (float("nan") if step.number == 4 else 1)

    monkeypatch.setattr(MaskTerm, "value", poisoned)
    with pytest.raises(UserError, match=r"step 4: expected a finite loss, got nan in the term 'mask'") as caught:
        train(run, SMALL)
    assert "\n" not in str(caught.value)
    assert load_run(tmp_path / "run").step == 3


def test_training_raises_the_psnr(ball_capture: Path, tmp_path: Path) -> None:
    """Catches training steps that have no effect. In 200 steps, PSNR must increase by at least 0.5 dB from grey
    points."""
    model = replace(SMALL.model, appearance="sh")
    config = replace(with_steps(SMALL, 200), checkpoint_steps=1000, model=model)
    trained_run(ball_capture, tmp_path / "run", config)
    lines = [json.loads(line) for line in (tmp_path / "run" / "metrics.jsonl").read_text().splitlines()]
    values = [line["psnr"] for line in lines if "psnr" in line]
    assert len(values) == 20
    assert np.mean(values[-5:]) > np.mean(values[:2]) + 0.5


def test_the_run_s_config_is_saved(ball_capture: Path, tmp_path: Path) -> None:
    """Catches settings that are missing in config.yaml. The commands eval and export read this file."""
    run = create_run(ball_capture, tmp_path / "run", SMALL)
    assert open_run(run.folder).config == run.config
    assert run.config.train == SMALL
    assert [run.capture.names[index] for index in run.test] == ["03"]


def test_folders_in_use_are_refused(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a new run that overwrites a user's files or another run."""
    (tmp_path / "diary.txt").write_text("mine")
    with pytest.raises(UserError, match="expected a new or empty folder, got other files"):
        create_run(ball_capture, tmp_path, SMALL)
    create_run(ball_capture, tmp_path / "run", SMALL)
    with pytest.raises(UserError, match="got a run; add --resume"):
        create_run(ball_capture, tmp_path / "run", SMALL)
    with pytest.raises(UserError, match="expected a trained run, got no intact checkpoint"):
        load_run(tmp_path / "run")


def test_points_from_the_user_s_files(ball_capture: Path, tmp_path: Path) -> None:
    """Catches bounds or initial points that come from carving although the user gives points."""
    rng = np.random.default_rng(0)
    for frame in range(3):
        xyz = rng.normal(0, 0.2, (2000, 3)).astype(np.float32)
        write_ply(tmp_path / "mine" / f"{frame:06d}.ply", xyz, np.zeros((2000, 3), np.uint8))
    run = create_run(ball_capture, tmp_path / "run", SMALL, tmp_path / "mine")
    first = run.initial_points(0).xyz.numpy()
    assert len(first) == SMALL.points
    mine = read_ply(tmp_path / "mine" / "000000.ply").xyz
    assert {tuple(point) for point in first.tolist()} <= {tuple(point) for point in mine.tolist()}
    (tmp_path / "mine" / "000002.ply").unlink()
    with pytest.raises(UserError, match=r"mine/000002.ply"):
        create_run(ball_capture, tmp_path / "other", SMALL, tmp_path / "mine")


@pytest.mark.slow
def test_a_run_resumes_after_a_kill_at_any_time(ball_capture: Path, tmp_path: Path) -> None:
    """Catches files of a run that are not written atomically. A run that is killed several times must still resume and
    finish."""
    overlay = tmp_path / "small.yaml"
    overlay.write_text(
        "points: 1500\nlayers: 8\ncheckpoint_steps: 1\nmodel: {hidden: 16, planes: {levels: 2, base_resolution: 16}}\n"
    )
    run = tmp_path / "run"
    command = [sys.executable, "-m", "fourd.cli.main", "train", str(ball_capture), "--out", str(run)]
    first = ["--test-views", "03", "--config", str(overlay), "--max-steps", "2000"]
    for delay in (0.1, 1.3, 2.1):
        process = subprocess.Popen([*command, *(first if not run.exists() else ["--resume"])])
        known = set(run.glob("checkpoints/*"))
        while set(run.glob("checkpoints/*")) <= known and process.poll() is None:
            time.sleep(0.01)
        time.sleep(delay)
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    step = load_run(run).step
    done = subprocess.run([*command, "--resume", "--max-steps", str(step + 3)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert load_run(run).step == step + 3
