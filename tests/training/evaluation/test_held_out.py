"""The held-out score of a run: the camera that is left out, the measurement, resuming, and what is printed about it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import yaml

from fourd.base.configs import save_config
from fourd.pipeline.make import create_run
from fourd.pipeline.report.summary import summarize_run
from fourd.reconstruction.training.config import HeldOutConfig
from fourd.reconstruction.training.evaluation.held_out import (
    NAME,
    HeldOutScore,
    best_surrounded,
    plan_held_out,
    read_score,
    save_score,
)
from fourd.reconstruction.training.loop import Trainer
from fourd.reconstruction.training.run import open_run
from fourd.reconstruction.training.run_layout import HULL, HULL_QUALITY
from tests.captures import ring_cameras
from tests.training.small import SMALL, full_config, quiet, train

CONFIG = replace(SMALL, test_views=(), max_steps=10, checkpoint_steps=4)
SCORE = HeldOutScore(6, ("05",), "left out", 20.0, 24.5, 8, "image", 20.0)


def test_the_best_surrounded_camera_is_left_out() -> None:
    """Catches a camera at the rim of the rig, from which no other camera can predict the view."""
    cameras = ring_cameras(12, 32)
    half = [cameras[index] for index in (0, 1, 2, 3, 4)]
    assert best_surrounded(half, np.zeros(3)) == 2


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6])
def test_small_rigs_leave_out_less(count: int) -> None:
    """Catches a rig of three cameras that loses one, a rig of four that loses one for as long as large rigs do, and a
    missing score without a reason."""
    plan = plan_held_out(HeldOutConfig(until=0.6), ring_cameras(count, 32), range(count), [], np.zeros(3))
    assert (plan.camera is None, bool(plan.reason)) == (count < 4,) * 2
    assert count < 4 or plan.until == (0.3 if count < 6 else 0.6)


def test_test_views_replace_the_camera_that_is_left_out() -> None:
    """Catches runs with test views whose training changes."""
    assert plan_held_out(HeldOutConfig(), ring_cameras(8, 32), range(7), [7], np.zeros(3)).camera is None


@pytest.mark.parametrize("scene", ["object", "full"])
def test_a_camera_is_left_out_until_it_is_measured(scene: str, ball_capture: Path, tmp_path: Path) -> None:
    """Catches a camera that is a target or a source view while it counts as held out, one that is never trained on, and
    a resumed run that leaves it out again, measures it after it was trained on, or has other bits."""
    full = replace(full_config(tmp_path / "shell.ply"), test_views=(), max_steps=10, checkpoint_steps=4)
    config = CONFIG if scene == "object" else full
    run = create_run(ball_capture, tmp_path / "whole", config)
    seen = _train_and_record(Trainer(run, None, quiet(), config))
    score = read_score(run.checkpoints)
    assert score is not None
    assert score.kind == "left out"
    assert score.step == 6
    assert score.part == ("box" if scene == "object" else "image")
    left_out = run.capture.names.index(score.cameras[0])
    assert not any(left_out in cameras for step, cameras in seen.items() if step < 6)
    assert any(left_out in cameras for step, cameras in seen.items() if step >= 6)

    broken = create_run(ball_capture, tmp_path / "broken", config)
    _train_and_record(Trainer(broken, None, quiet(), config), stop=7)
    assert read_score(broken.checkpoints) is not None, "the score was measured after the checkpoint at step 4"
    resumed = Trainer(open_run(broken.folder), None, quiet(), config)
    assert resumed.held_out.camera == left_out
    _train_and_record(resumed, stop=9)
    resumed = Trainer(open_run(broken.folder), None, quiet(), config)
    assert resumed.held_out.camera is None
    resumed.train()
    assert read_score(broken.checkpoints) == score
    expected, got = (each / "checkpoints/00000010.points/000000.safetensors" for each in (run.folder, broken.folder))
    assert expected.read_bytes() == got.read_bytes()


def _train_and_record(trainer: Trainer, stop: int = 1000) -> dict[int, list[int]]:
    """Train until the step ``stop``, and return the target and the source views of each step."""
    step = trainer.stepper.step
    seen: dict[int, list[int]] = {}

    def recorded(*arguments: Any) -> Any:
        sample, number = arguments[2], arguments[-1]
        if number == stop:
            raise InterruptedError
        seen[number] = [sample.target, *sample.sources]
        return step(*arguments)

    trainer.stepper.step = recorded  # type: ignore[method-assign]
    if stop < 1000:
        with pytest.raises(InterruptedError):
            trainer.train()
    else:
        trainer.train()
    return seen


def test_test_views_are_measured_at_the_end(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a run with test views whose end says nothing about them."""
    run = create_run(ball_capture, tmp_path / "run", SMALL)
    train(run, SMALL)
    score = read_score(run.checkpoints)
    assert score is not None
    assert (score.kind, score.cameras, score.step) == ("test", ("03",), 6)
    assert summarize_run(run.folder).lines[0].startswith("held out: test views 03: ")


def test_runs_of_older_versions_leave_out_nothing(ball_capture: Path, tmp_path: Path) -> None:
    """Catches an old run that was trained on all cameras, and after --resume counts one of them as held out."""
    run = create_run(ball_capture, tmp_path / "run", CONFIG)
    path = run.folder / "config.yaml"
    content = yaml.safe_load(path.read_text())
    del content["train"]["held_out"]
    path.write_text(yaml.safe_dump(content))
    old = open_run(run.folder)
    trainer = Trainer(old, None, quiet(), old.config.train)
    assert trainer.held_out.camera is None
    assert not trainer.held_out.exist
    assert trainer.held_out.training == old.training
    save_config(old.config, path)
    assert not open_run(run.folder).config.train.held_out.on


def test_large_gaps_and_small_hulls_end_with_a_warning(tmp_path: Path) -> None:
    """Catches a run that fits its cameras only, or whose hull lacks a part of the subject, and that ends as if all was
    well."""
    save_score(SCORE, tmp_path / "checkpoints")
    (tmp_path / HULL).mkdir()
    poor = "29, frames 0 to 11: the hull of the other views covers 27% of this matte"
    (tmp_path / HULL / HULL_QUALITY).write_text(f'{{"kept_share": 0.62, "poor": ["{poor}"]}}')
    summary = summarize_run(tmp_path)
    assert summary.lines[0] == "held out: camera 05 until step 6: 20.0 dB; training views 24.5 dB"
    assert "4.5 dB worse than training views" in summary.warnings[0]
    assert "fourd check" in summary.warnings[0]
    assert "only 62%" in summary.warnings[1]
    assert poor in summary.warnings[1]
    save_score(replace(SCORE, psnr=22.0), tmp_path / "checkpoints")
    (tmp_path / HULL / HULL_QUALITY).write_text('{"kept_share": 0.97, "poor": []}')
    assert not summarize_run(tmp_path).warnings


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"step": -1}', "nonsense"])
def test_damaged_scores_count_as_missing(text: str, tmp_path: Path) -> None:
    """Catches a damaged file in a run that was sent by somebody else and that ends info or the live page with a
    traceback."""
    (tmp_path / NAME).write_text(text)
    assert read_score(tmp_path) is None
    save_score(SCORE, tmp_path)
    assert read_score(tmp_path) == SCORE


def test_a_warm_start_measures_nothing(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a score of a camera that the networks of the previous segment were trained on."""
    run = create_run(ball_capture, tmp_path / "run", CONFIG)
    trainer = Trainer(run, None, quiet(), CONFIG)
    trainer.done = 0
    trainer._checkpoint()
    with torch.no_grad():
        warm = Trainer(open_run(run.folder), None, quiet(), CONFIG)
    assert warm.held_out.camera is None
    assert warm.held_out.score is not None
    assert "trained on all cameras" in warm.held_out.score.describe()
