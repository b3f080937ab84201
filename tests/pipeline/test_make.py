"""Tests of ``make_scene``: a stage runs once, and runs again only if its inputs or settings change."""

from __future__ import annotations

import io
import os
import shutil
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from fourd.base.errors import UserError
from fourd.base.formats.ply import write_ply
from fourd.cli.main import main
from fourd.pipeline.graphs.capture import stages_to_capture
from fourd.pipeline.make import create_run, make_scene
from fourd.pipeline.stage import Context
from fourd.reconstruction.training.config import RefineConfig, TrainConfig
from fourd.reconstruction.training.loop import Trainer
from fourd.reconstruction.training.metrics_log import MetricsLog
from fourd.recording.importing.importer import ImportOptions
from fourd.recording.matting.sequence import MatteSettings
from tests.captures import sphere
from tests.faults.chain import SMALL as SMALL_SETTINGS
from tests.matting.captures import write_capture_without_masks, write_video
from tests.training.small import SMALL, full_config, with_steps

NAMES = ("import", "check", "repair", "mattes", "plates", "adjust", "carve", "points", "background", "train", "bake")


def make(capture: Path, out: Path, config: TrainConfig, points_from: Path | None = None) -> dict[str, bool]:
    """Run all stages. The result maps each stage name to whether the work of the stage was executed."""
    text = io.StringIO()
    context = Context(Console(file=text, width=200))
    make_scene(capture, out, config, MatteSettings(), context, points_from=points_from)
    lines = text.getvalue().splitlines()
    listed = [name for name in NAMES if any(line.startswith((f"{name}: up to", f"{name}: run")) for line in lines)]
    return {name: f"{name}: running" in lines for name in listed}


def test_changed_inputs_and_settings_rerun_dependent_stages(ball_capture: Path, tmp_path: Path) -> None:
    """Catches outdated results after a change, and stages that run again without a change."""
    capture, out = tmp_path / "capture", tmp_path / "scene.4dv"
    shutil.copytree(ball_capture, capture)
    config = with_steps(SMALL, 2)
    assert make(capture, out, config) == dict.fromkeys(("check", "repair", "carve", "train", "bake"), True)
    assert not any(make(capture, out, config).values())
    now = make(capture, out, replace(config, seed=5))
    assert now == {"check": False, "repair": False, "carve": False, "train": True, "bake": True}
    out.unlink()
    now = make(capture, out, replace(config, seed=5))
    assert now == {"check": False, "repair": False, "carve": False, "train": False, "bake": True}
    os.utime(capture / "images" / "00" / "000001.png", (1, 1))
    assert all(make(capture, out, replace(config, seed=5)).values())


def test_cameras_are_adjusted_before_carving(ball_capture: Path, tmp_path: Path) -> None:
    """Catches points that are carved with outdated cameras, and cameras that are adjusted again after a change of a
    learning rate."""
    capture, out = tmp_path / "capture", tmp_path / "scene.4dv"
    shutil.copytree(ball_capture, capture)
    refine = RefineConfig(poses=True)
    config = replace(with_steps(SMALL, 2), refine=refine)
    assert make(capture, out, config) == dict.fromkeys(("check", "repair", "adjust", "carve", "train", "bake"), True)
    now = make(capture, out, replace(config, refine=replace(refine, pose_rate=1e-3)))
    assert now == {"check": False, "repair": False, "adjust": False, "carve": False, "train": True, "bake": True}
    now = make(capture, out, replace(config, refine=replace(refine, rotation_deg=1.0)))
    assert now == {"check": False, "repair": False, "adjust": True, "carve": True, "train": True, "bake": True}
    now = make(capture, out, with_steps(SMALL, 2))
    assert now == {"check": False, "repair": False, "carve": True, "train": True, "bake": True}


def test_videos_become_a_scene(tmp_path: Path) -> None:
    """Catches a stage that is missing or repeated between videos and scene."""
    capture, source, out = (
        write_capture_without_masks(tmp_path, frames=6, size=64),
        tmp_path / "videos",
        tmp_path / "scene.4dv",
    )
    source.mkdir()
    for name in ("intri.yml", "extri.yml"):
        shutil.copy(capture / name, source / name)
    for folder in (capture / "images").iterdir():
        write_video(source / f"{folder.name}.mp4", sorted(folder.iterdir()))
    config = with_steps(SMALL, 2)
    stages = ["import", "check", "repair", "mattes", "plates", "carve", "train", "bake"]
    assert make(source, out, config) == dict.fromkeys(stages, True)
    assert make(source, out, config) == dict.fromkeys(stages, False)
    assert not (source / ".fourd").exists(), "the folder of videos belongs to the user"
    matte = tmp_path / "scene.work" / "capture" / ".fourd" / "mattes" / "00" / "000002.png"
    matte.write_bytes((matte.parent / "000001.png").read_bytes())
    assert make(source, out, config) == dict.fromkeys(stages[:4], False) | dict.fromkeys(stages[4:], True)


def test_mattes_of_the_chosen_method_are_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches mattes of fourd matte --method masks that fourd make replaces by mattes of the default method. Also
    catches mattes of earlier images that are kept silently, and an option --method of fourd make that has no effect.
    """
    monkeypatch.setenv("COLUMNS", "1000")
    capture = write_capture_without_masks(tmp_path, frames=3, size=64)
    masks, out = tmp_path / "truth" / "masks", tmp_path / "scene.4dv"
    small = [word for name in SMALL_SETTINGS for word in ("--set", name)]
    words = ["make", str(capture), "-o", str(out), "--workers", "1", *small]

    def mattes() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in (capture / ".fourd" / "mattes").glob("*/*")}

    assert main([*words, "--method", "motion"]) == 0
    of_motion = mattes()
    assert main(["matte", str(capture), "--method", "masks", "--masks", str(masks), "--workers", "1"]) == 0
    chosen = mattes()
    assert chosen != of_motion
    for _ in range(2):
        capsys.readouterr()
        assert main(words) == 0
        assert "keeping the mattes of fourd matte --method masks; add --method" in capsys.readouterr().out
        assert mattes() == chosen
    os.utime(capture / "images" / "00" / "000001.png", (1, 1))
    assert main(words) == 2
    assert "got mattes of earlier files; make them again with fourd matte --method masks" in capsys.readouterr().err
    assert mattes() == chosen
    assert main(["matte", str(capture), "--method", "masks", "--masks", str(masks), "--workers", "1"]) == 0
    assert main(words) == 0
    assert main([*words, "--method", "motion"]) == 0
    assert mattes() == of_motion
    capsys.readouterr()
    assert main(words) == 0
    assert "keeping" not in capsys.readouterr().out


def test_other_folders_are_not_used_for_results(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a folder that is emptied although it contains a user's own files."""
    (tmp_path / "scene.work").mkdir()
    (tmp_path / "scene.work" / "mine.txt").write_text("mine")
    with pytest.raises(UserError, match="expected a folder made by fourd make"):
        make_scene(ball_capture, tmp_path / "scene.4dv", SMALL, MatteSettings(), Context())


def test_a_calibration_is_for_videos(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a given calibration that is silently ignored, and an import that is not repeated after its change."""
    out, options = tmp_path / "scene.4dv", ImportOptions(calibration=str(ball_capture))
    with pytest.raises(UserError, match=r"--calibration: expected videos without a calibration, got the capture"):
        make_scene(ball_capture, out, SMALL, MatteSettings(), Context(), imports=options)
    assert not (tmp_path / "scene.work").exists()
    (stage,) = stages_to_capture(tmp_path / "videos", tmp_path / "capture", options)
    assert ball_capture in [artefact.path for artefact in stage.inputs]


def test_stages_of_a_full_scene_depend_on_what_they_read(ball_capture: Path, tmp_path: Path) -> None:
    """Catches background points that are computed again after a change of the foreground, and outdated background
    points."""
    capture, out = Path(shutil.copytree(ball_capture, tmp_path / "capture")), tmp_path / "scene.4dv"
    config = with_steps(full_config(tmp_path / "seeds.ply"), 2)
    names = ("check", "repair", "carve", "plates", "background", "train", "bake")

    def stages_run(config: TrainConfig) -> list[str]:
        done = make(capture, out, config)
        assert tuple(name for name in done if name != "points") == tuple(name for name in NAMES if name in names)
        return [name for name, is_done in done.items() if is_done]

    assert set(stages_run(config)) == set(names)
    assert stages_run(config) == []
    config = replace(config, points=config.points - 100)
    assert stages_run(config) == ["carve", "train", "bake"]
    config = replace(config, background=replace(config.background, points=1000))
    assert stages_run(config) == ["background", "train", "bake"]
    config = replace(config, rates=replace(config.rates, planes=1e-3))
    assert stages_run(config) == ["train", "bake"]
    config = replace(config, test_views=("02",))
    assert stages_run(config) == ["plates", "carve", "background", "train", "bake"]
    seeds = tmp_path / "seeds.ply"
    seeds.write_bytes(seeds.read_bytes())
    assert stages_run(config) == ["background", "train", "bake"]


def test_given_points_replace_carving(ball_capture: Path, tmp_path: Path) -> None:
    """Catches training on carved points instead of given points, and changes of given points that are ignored."""
    points, out = tmp_path / "points", tmp_path / "scene.4dv"
    for frame in range(3):
        write_ply(points / f"{frame:06d}.ply", sphere(600) * 0.3, np.full((600, 3), 90, np.uint8))
    config = with_steps(SMALL, 2)
    assert make(ball_capture, out, config, points) == dict.fromkeys(
        ("check", "repair", "points", "train", "bake"), True
    )
    assert not any(make(ball_capture, out, config, points).values())
    os.utime(points / "000001.ply", (1, 1))
    assert make(ball_capture, out, config, points) == {
        "check": False,
        "repair": False,
        "points": True,
        "train": True,
        "bake": True,
    }


def test_interrupted_training_resumes_to_the_same_scene(
    ball_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches an interrupted training that restarts from step 0, and a resumed training with a different result."""
    config = with_steps(SMALL, 6)
    make(ball_capture, tmp_path / "whole.4dv", config)
    steps: list[int] = []
    interruptions: list[int] = []
    step = Trainer._step

    def interrupted(self: Trainer, log: MetricsLog) -> None:
        if self.done == 4 and not interruptions:
            interruptions.append(self.done)
            signal.raise_signal(signal.SIGINT)
        steps.append(self.done)
        step(self, log)

    monkeypatch.setattr(Trainer, "_step", interrupted)
    with pytest.raises(KeyboardInterrupt):
        make(ball_capture, tmp_path / "stopped.4dv", config)
    done = make(ball_capture, tmp_path / "stopped.4dv", config)
    assert done == {"check": False, "repair": False, "carve": False, "train": True, "bake": True}
    assert steps == [0, 1, 2, 3, 4, 5]
    assert (tmp_path / "whole.4dv").read_bytes() == (tmp_path / "stopped.4dv").read_bytes()


def test_an_interrupted_create_run_keeps_finished_stages(
    ball_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a second ``fourd train`` that repeats carving or rejects the run folder after an interruption before
    training."""
    config, run = full_config(tmp_path / "seeds.ply"), tmp_path / "run"
    seeds = (tmp_path / "seeds.ply").read_bytes()
    (tmp_path / "seeds.ply").unlink()
    with pytest.raises((UserError, OSError)):
        create_run(ball_capture, run, config)
    before = {path: path.stat().st_mtime_ns for path in run.glob("hull/*.ply")}
    assert len(before) == 3
    (tmp_path / "seeds.ply").write_bytes(seeds)
    assert create_run(ball_capture, run, config).training
    assert {path: path.stat().st_mtime_ns for path in before} == before
