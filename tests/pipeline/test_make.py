"""``make_scene``: stages are done once, and again when what they depend on changes."""

from __future__ import annotations

import io
import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from fourd.errors import UserError
from fourd.matting.stage import MatteSettings
from fourd.pipeline.make import make_scene
from fourd.pipeline.stage import Context
from fourd.training.config import RefineConfig, TrainConfig
from tests.matting.captures import write_capture_without_masks, write_video
from tests.training.small import SMALL, with_steps

NAMES = ("import", "check", "mattes", "plates", "adjust", "carve", "points", "background", "train", "bake")


def make(capture: Path, out: Path, config: TrainConfig, points_from: Path | None = None) -> dict[str, bool]:
    """Run everything; maps the name of each stage in the graph to whether its work was done."""
    text = io.StringIO()
    context = Context(Console(file=text, width=200))
    make_scene(capture, out, config, MatteSettings(), context, points_from=points_from)
    lines = text.getvalue().splitlines()
    listed = [name for name in NAMES if any(line.startswith((f"{name}: up to", f"{name}: run")) for line in lines)]
    return {name: f"{name}: running" in lines for name in listed}


def test_stages_depend_on_what_they_should(ball_capture: Path, tmp_path: Path) -> None:
    """Catches stale results after a change, and work done twice without one."""
    capture, out = tmp_path / "capture", tmp_path / "scene.4dv"
    shutil.copytree(ball_capture, capture)
    config = with_steps(SMALL, 2)
    assert make(capture, out, config) == dict.fromkeys(("check", "carve", "train", "bake"), True)
    assert not any(make(capture, out, config).values())
    now = make(capture, out, replace(config, seed=5))
    assert now == {"check": False, "carve": False, "train": True, "bake": True}
    out.unlink()
    now = make(capture, out, replace(config, seed=5))
    assert now == {"check": False, "carve": False, "train": False, "bake": True}
    os.utime(capture / "images" / "00" / "000001.png", (1, 1))
    assert all(make(capture, out, replace(config, seed=5)).values())


def test_refined_cameras_come_before_carving(ball_capture: Path, tmp_path: Path) -> None:
    """Catches points carved from cameras that are no longer these, and features sought again for a learning rate."""
    capture, out = tmp_path / "capture", tmp_path / "scene.4dv"
    shutil.copytree(ball_capture, capture)
    refine = RefineConfig(poses=True)
    config = replace(with_steps(SMALL, 2), refine=refine)
    assert make(capture, out, config) == dict.fromkeys(("check", "adjust", "carve", "train", "bake"), True)
    now = make(capture, out, replace(config, refine=replace(refine, pose_rate=1e-3)))
    assert now == {"check": False, "adjust": False, "carve": False, "train": True, "bake": True}
    now = make(capture, out, replace(config, refine=replace(refine, rotation_deg=1.0)))
    assert now == {"check": False, "adjust": True, "carve": True, "train": True, "bake": True}
    now = make(capture, out, with_steps(SMALL, 2))
    assert now == {"check": False, "carve": True, "train": True, "bake": True}


def test_videos_become_a_scene(tmp_path: Path) -> None:
    """Catches a stage that is left out, or done again, on the way from videos to a scene."""
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
    stages = ["import", "check", "mattes", "plates", "carve", "train", "bake"]
    assert make(source, out, config) == dict.fromkeys(stages, True)
    assert make(source, out, config) == dict.fromkeys(stages, False)
    assert not (source / ".fourd").exists(), "the videos' folder is the user's"
    matte = tmp_path / "scene.work" / "capture" / ".fourd" / "mattes" / "00" / "000002.png"
    matte.write_bytes((matte.parent / "000001.png").read_bytes())
    assert make(source, out, config) == dict.fromkeys(stages[:3], False) | dict.fromkeys(stages[3:], True)


def test_a_folder_that_make_did_not_make_is_left_alone(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a work folder emptied though someone else's files were in it."""
    (tmp_path / "scene.work").mkdir()
    (tmp_path / "scene.work" / "mine.txt").write_text("mine")
    with pytest.raises(UserError, match="expected a folder made by fourd make"):
        make_scene(ball_capture, tmp_path / "scene.4dv", SMALL, MatteSettings(), Context())
