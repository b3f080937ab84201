"""Tests of the plan that ``fourd make`` prints before it starts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from fourd.pipeline.graphs.plan import describe_plan
from fourd.pipeline.graphs.run import RunRequest
from fourd.pipeline.graphs.scene import SceneStages
from fourd.reconstruction.training.config import SegmentConfig, TrainConfig
from fourd.recording.importing.importer import ImportOptions
from tests.importing.test_layouts import pose2sim


def planned(source: Path, train: TrainConfig, workers: int) -> str:
    work = Path("work")
    run = RunRequest(source, work / "run", train)
    return describe_plan(SceneStages(source, run, ImportOptions(), work, Path("scene.4dv")), workers)


def test_plan_names_the_stages_and_the_duration(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a plan that omits a stage that runs, or the budget of the training."""
    train = TrainConfig(max_seconds=1800)
    plan = planned(ball_capture, train, 2)
    assert plan.startswith(
        "plan: check, repair, colours, carve, train (30 min), bake; about 30 min for 8 cameras and 3 frames"
    )
    whole = replace(train, scene="full", max_seconds=60)
    assert "carve, plates, background (3 min), train (60 s), bake; about 4 min" in planned(ball_capture, whole, 2)
    parts = replace(train, segments=SegmentConfig(frames=2, overlap=0))
    assert "carve, train 2 segments (60 min), bake" in planned(ball_capture, parts, 2)
    videos = planned(pose2sim(tmp_path), train, 2)
    assert "plan: import, check, repair, mattes, plates, colours, carve, train (30 min), bake" in videos
    assert "3 cameras and 2 frames" in videos
