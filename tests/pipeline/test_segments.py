"""Tests of runs with segments: stages, resuming, one scene of all segments, and the start from a previous segment."""

from __future__ import annotations

import io
import json
import shutil
import weakref
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from rich.console import Console

from fourd.base.errors import UserError
from fourd.cli.main import main
from fourd.pipeline.graphs.run import RunRequest, stages_to_run
from fourd.pipeline.make import make_scene
from fourd.pipeline.runner import Runner
from fourd.pipeline.segments import run_segment
from fourd.pipeline.stage import Context
from fourd.pipeline.stages.bake import BakeFiles, BakeSettings, run_bake
from fourd.reconstruction.model import PointModel
from fourd.reconstruction.training.checkpoints import latest_checkpoint, load_checkpoint
from fourd.reconstruction.training.config import SegmentConfig, TrainConfig
from fourd.reconstruction.training.loop import Trainer
from fourd.reconstruction.training.run import load_run, open_run
from fourd.reconstruction.training.run_layout import CHECKPOINTS, segment_folder, segment_folders
from fourd.reconstruction.training.segments.fade import kept_points
from fourd.reconstruction.training.segments.segmented_run import SegmentedRun, open_trained
from fourd.reconstruction.training.segments.warm_start import time_plane_names, write_warm_start
from fourd.recording.matting.sequence import MatteSettings
from fourd.scene import SceneReader, open_scene
from tests.captures import write_ball_capture
from tests.training.small import SMALL, with_steps

CONFIG = replace(with_steps(SMALL, 3), segments=SegmentConfig(frames=6, overlap=2))
"""Three segments of the 12 frames of the capture: 0 to 4, 3 to 7, 6 to 11."""


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_ball_capture(tmp_path_factory.mktemp("long"), frames=12)


@pytest.fixture(scope="module")
def trained(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A trained run with three segments. Tests must not change it."""
    run = tmp_path_factory.mktemp("segmented") / "run"
    Runner(Context()).run(stages_to_run(RunRequest(capture, run, CONFIG)))
    return run


def make(capture: Path, out: Path, config: TrainConfig) -> list[str]:
    """Run all stages. The result lists the stages whose work was executed."""
    text = io.StringIO()
    make_scene(capture, out, config, MatteSettings(), Context(Console(file=text, width=200)))
    return [line.removesuffix(": running") for line in text.getvalue().splitlines() if line.endswith(": running")]


def test_each_segment_is_cached_and_repeated_by_itself(capture: Path, tmp_path: Path) -> None:
    """Catches segments that are trained again because another segment was lost, and segments of an earlier division
    that are not removed.
    """
    out, segments = tmp_path / "scene.4dv", ["train 000", "train 001", "train 002"]
    assert make(capture, out, CONFIG) == ["check", "repair", "carve", "segments", *segments, "bake"]
    with open_scene(out) as scene:
        assert scene.manifest.frame_numbers == tuple(range(12))
    assert make(capture, out, CONFIG) == []
    run = tmp_path / "scene.work" / "run"
    shutil.rmtree(segment_folder(run, 1) / CHECKPOINTS)
    assert make(capture, out, CONFIG) == ["train 001"]
    fewer = replace(CONFIG, segments=SegmentConfig(frames=12, overlap=2))
    assert make(capture, out, fewer) == ["segments", "train 000", "bake"]
    assert [folder.name for folder in segment_folders(run)] == ["000"]
    assert make(capture, out, replace(CONFIG, segments=SegmentConfig())) == ["train", "bake"]
    assert not segment_folders(run)


def test_an_interrupted_segment_resumes(capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches finished segments that are trained again after an interruption, and an interrupted segment that is
    trained from its start.
    """
    out, steps = tmp_path / "scene.4dv", list[tuple[str, int]]()
    config = replace(CONFIG, checkpoint_steps=1)
    step = Trainer._step

    def interrupted(self: Trainer, log: object) -> None:
        steps.append((self.run.folder.name, self.done))
        if steps[-1] == ("001", 2) and ("000", 0) in steps:
            raise KeyboardInterrupt
        step(self, log)  # type: ignore[arg-type]

    monkeypatch.setattr(Trainer, "_step", interrupted)
    with pytest.raises(KeyboardInterrupt):
        make(capture, out, config)
    steps.clear()
    assert make(capture, out, config) == ["train 001", "train 002", "bake"]
    assert steps == [("001", 2), ("002", 0), ("002", 1), ("002", 2)]


def test_a_segment_is_an_ordinary_run_of_its_frames(trained: Path) -> None:
    """Catches time planes that cover the whole capture, and points or bounds that differ from those of the run."""
    segment = load_run(segment_folder(trained, 1))
    assert segment.run.capture.frame_numbers == (3, 4, 5, 6, 7)
    assert [segment.run.capture.time(frame) for frame in range(5)] == [0, 0.25, 0.5, 0.75, 1]
    planes = segment.model.planes
    assert {planes.planes[index].shape[0] for index in planes.time_plane_indices} == {5}
    whole = open_run(trained)
    assert whole.capture.time(6) == 6 / 11
    assert torch.equal(segment.run.initial_points(2).xyz, whole.initial_points(5).xyz)
    scene = replace(segment.run.config.scene, first_frame=0, frame_count=12)
    assert scene == whole.config.scene


def test_the_scene_shows_the_segments_that_own_a_frame(trained: Path, tmp_path: Path) -> None:
    """Catches frames from the wrong segment, shared frames from one segment, and an export that differs from the
    run."""
    run_bake(BakeFiles(trained, tmp_path / "scene.4dv"), BakeSettings(layers=8), Context())
    segments = [load_run(segment_folder(trained, index)) for index in range(3)]
    with open_scene(tmp_path / "scene.4dv") as scene, closing(open_trained(trained)) as run:
        frames = [SceneReader(tmp_path / "scene.4dv").read(frame) for frame in range(12)]
        camera = run.run.capture.cameras[3]
        for frame in (1, 3, 11):
            shown, live = scene.render(camera, frame).rgb, run.render(frame, camera, 8, exclude=3).rgb
            assert np.abs(shown - live).mean() < 5e-3
    assert np.array_equal(frames[2].xyz, segments[0].frames.get(2).xyz.numpy())
    assert np.array_equal(frames[5].xyz, segments[1].frames.get(2).xyz.numpy())
    assert np.array_equal(frames[11].xyz, segments[2].frames.get(5).xyz.numpy())
    both = [segments[0].frames.get(3).xyz.numpy(), segments[1].frames.get(0).xyz.numpy()]
    rows = [kept_points(SMALL.points, share, is_first=share > 0.5) for share in (2 / 3, 1 / 3)]
    expected = np.concatenate([xyz[kept] for xyz, kept in zip(both, rows, strict=True)])
    assert frames[3].point_count == SMALL.points
    assert sorted(map(tuple, frames[3].xyz)) == sorted(map(tuple, expected))


def test_at_most_two_segments_are_open(trained: Path) -> None:
    """Catches memory that grows with the number of segments."""
    models = set[weakref.ref[PointModel]]()
    with closing(open_trained(trained)) as run:
        assert isinstance(run, SegmentedRun)
        for frame in range(12):
            owners = [weakref.ref(part.trained.model) for part in run.at(frame)]
            assert len(owners) == (2 if frame in (3, 4, 6, 7) else 1)
            models.update(owners)
            assert sum(1 for model in models if model() is not None) == len(owners)
    assert len(models) == 3


def test_a_run_with_segments_has_no_model_of_its_own(trained: Path, tmp_path: Path) -> None:
    """Catches a command that silently uses one segment instead of all, and an export of untrained segments."""
    with pytest.raises(UserError, match=r"got a run with segments; name one segment, such as .*run/segments/000"):
        load_run(trained)
    part = tmp_path / "run"
    shutil.copytree(trained, part)
    shutil.rmtree(segment_folder(part, 1) / CHECKPOINTS)
    with pytest.raises(UserError, match=r"segments/001: expected the trained segment of the frames 3 to 7, got no"):
        open_trained(part)


def test_commands_accept_a_run_with_segments(trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a command that does not accept a run with segments, and a message that does not name a fix."""
    scores, out = tmp_path / "scores.json", tmp_path / "pictures"
    assert main(["eval", str(trained), "--json", str(scores)]) == 0
    assert json.loads(scores.read_text())["frames"] == list(range(12))
    assert main(["render", str(trained), "--views", "03", "--frames", "2:5", "-o", str(out)]) == 0
    assert len(list((out / "03").iterdir())) == 3
    assert main(["verify", str(trained)]) == 0
    assert main(["info", str(trained)]) == 0
    text = capsys.readouterr().out
    assert "3 checkpoints" in text
    assert "3, of which 3 have a checkpoint" in text
    assert main(["eval", str(trained), "--refine-test"]) == 2
    assert "--refine-test: expected a run with one model, got the segments of" in capsys.readouterr().err


def test_a_segment_resumes_with_a_larger_budget(capture: Path, trained: Path, tmp_path: Path) -> None:
    """Catches a run with segments that --resume treats as one model."""
    run = tmp_path / "run"
    shutil.copytree(trained, run)
    assert main(["train", str(capture), "-o", str(run), "--resume", "--max-steps", "4"]) == 0
    assert [load_run(folder).step for folder in segment_folders(run)] == [4, 4, 4]


def test_a_warm_start_copies_the_networks_of_the_previous_segment(trained: Path, tmp_path: Path) -> None:
    """Catches networks that start untrained, and rows of time planes that are assigned to the wrong frames."""
    run = tmp_path / "run"
    shutil.copytree(trained, run)
    second = segment_folder(run, 1)
    shutil.rmtree(second / CHECKPOINTS)
    write_warm_start(open_run(second), segment_folder(run, 0))
    found, _ = latest_checkpoint(second / CHECKPOINTS)
    assert found is not None
    _, started, _ = load_checkpoint(found)
    before = load_run(segment_folder(run, 0)).model
    names = {f"model.{name}" for name in time_plane_names(before)}
    assert len(names) == 3 * SMALL.model.planes.levels
    for name, value in before.state_dict().items():
        given = started[f"model.{name}"]
        if f"model.{name}" in names:
            assert torch.equal(given, value[[3, 4, 4, 4, 4]])
        else:
            assert torch.equal(given, value)


def test_segments_with_a_warm_start_depend_on_each_other(capture: Path, tmp_path: Path) -> None:
    """Catches a segment that is not trained again although its warm start comes from a segment that was trained again.
    Also catches a warm start with fewer training steps.
    """
    config = replace(CONFIG, segments=replace(CONFIG.segments, warm_start=True))
    stages = stages_to_run(RunRequest(capture, tmp_path / "run", config))
    last = stages[-1]
    keys: dict[str, str] = {}
    for stage in stages:
        keys[stage.name] = stage.key(keys)
    assert last.key(keys) != last.key(keys | {"train 001": "another"})
    assert last.work is run_segment
    Runner(Context()).run(stages)
    assert [load_run(folder).step for folder in segment_folders(tmp_path / "run")] == [3, 3, 3]
