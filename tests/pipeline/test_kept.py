"""Tests of what happens to a trained run when ``fourd make`` has other settings: it is kept, and used again."""

from __future__ import annotations

import io
import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

from fourd.base.errors import UserError
from fourd.pipeline.make import make_scene
from fourd.pipeline.stage import Context
from fourd.pipeline.work.kept import find_trained
from fourd.reconstruction.training.config import SegmentConfig, TrainConfig
from fourd.reconstruction.training.run import load_run, open_run
from fourd.recording.importing.importer import ImportOptions
from fourd.recording.matting.sequence import MatteSettings
from tests.captures import write_ball_capture
from tests.training.small import SMALL, with_steps

CONFIG = replace(with_steps(SMALL, 2), test_views=())

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def ball(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture of a ball: 4 cameras, 6 frames, 32 x 32."""
    return write_ball_capture(tmp_path_factory.mktemp("ball"), cameras=4, frames=6, size=32)


def make(
    source: Path, out: Path, config: TrainConfig = CONFIG, *, force: bool = False, imports: ImportOptions | None = None
) -> list[str]:
    """Make a scene, and return the printed lines."""
    text = io.StringIO()
    context = Context(Console(file=text, width=1000))
    make_scene(source, out, config, MatteSettings(), context, force=force, imports=imports)
    return text.getvalue().splitlines()


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def line(lines: list[str], start: str) -> str:
    found = [each for each in lines if each.startswith(start)]
    assert len(found) == 1, lines
    return found[0]


def test_a_finished_run_of_other_settings_is_kept(ball: Path, tmp_path: Path) -> None:
    """Catches a finished run that a forgotten --test-views deletes, and a change that is not named."""
    out, work = tmp_path / "scene.4dv", tmp_path / "scene.work"
    make(ball, out, replace(CONFIG, test_views=("01", "02")))
    before, scene = contents(work / "run"), out.read_bytes()
    lines = make(ball, out, replace(CONFIG, seed=3))
    assert "test views: 01, 02 -> none" in line(lines, "carve: again")
    assert "seed: 0 -> 3" in line(lines, "carve: again")
    kept = line(lines, f"{work / 'run'}: the finished run of 2 steps is kept as {work / 'run.1'}")
    assert "MB" in kept
    assert contents(work / "run.1") == before
    assert load_run(work / "run.1").step == 2
    assert open_run(work / "run").config.train.seed == 3
    assert out.read_bytes() != scene
    # The first settings again: the kept run is used, and the second one is kept.
    lines = make(ball, out, replace(CONFIG, test_views=("01", "02")))
    assert f"{work / 'run'}: {work / 'run.1'} has these settings and is used again" in lines
    assert "train: running" not in lines
    assert out.read_bytes() == scene
    assert contents(work / "run") == before
    assert sorted(path.name for path in work.glob("run*")) == ["run", "run.2"]
    assert not any("running" in each for each in make(ball, out, replace(CONFIG, test_views=("01", "02"))))


def test_results_before_training_are_shared(ball: Path, tmp_path: Path) -> None:
    """Catches points that are carved again although only training has changed, and a kept run without its points."""
    out, work = tmp_path / "scene.4dv", tmp_path / "scene.work"
    make(ball, out)
    for step in (3, 4):
        lines = make(ball, out, replace(CONFIG, max_steps=step))
        assert f"max steps: {step - 1} -> {step}" in line(lines, "train: again")
        assert line(lines, "carve").startswith("carve: up to date")
    for name in ("run", "run.1", "run.2"):
        assert len(list((work / name / "hull").glob("*.ply"))) == 6
    assert [find_trained(work / name).steps for name in ("run.1", "run.2", "run")] == [2, 3, 4]  # type: ignore[union-attr]


def test_force_replaces_the_run(ball: Path, tmp_path: Path) -> None:
    """Catches --force that keeps a run on a full disk, or that is not mentioned."""
    out, work = tmp_path / "scene.4dv", tmp_path / "scene.work"
    make(ball, out)
    lines = make(ball, out, replace(CONFIG, test_views=("01",)), force=True)
    assert f"{work / 'run'}: the finished run of 2 steps is deleted, because of --force" in lines
    assert [path.name for path in work.glob("run*")] == ["run"]


def test_an_invalid_setting_loses_nothing(ball: Path, tmp_path: Path) -> None:
    """Catches a wrong name in --test-views that costs the finished run."""
    out, work = tmp_path / "scene.4dv", tmp_path / "scene.work"
    make(ball, out)
    before = contents(work / "run" / "checkpoints")
    with pytest.raises(UserError, match="nothing"):
        make(ball, out, replace(CONFIG, test_views=("nothing",)))
    lines = make(ball, out)
    assert "train: running" not in lines
    assert contents(work / "run" / "checkpoints") == before


def test_records_of_earlier_versions(ball: Path, tmp_path: Path) -> None:
    """Catches a run that is trained again or deleted because an earlier version of fourd wrote the record."""
    out, work = tmp_path / "scene.4dv", tmp_path / "scene.work"
    make(ball, out)
    record = work / "stages.json"
    entries = json.loads(record.read_text())["stages"]
    old = {name: entry["finished"] for name, entry in entries.items()}
    old |= {f"{name} started": entry["started"] for name, entry in entries.items()}
    record.write_text(json.dumps(old))
    assert not any("running" in each for each in make(ball, out))
    record.write_text(json.dumps(old))
    lines = make(ball, out, replace(CONFIG, seed=3))
    assert "made by an earlier version of fourd" in line(lines, "train: again")
    line(lines, f"{work / 'run'}: the finished run of 2 steps is kept as {work / 'run.1'}")
    # Without any record, the run is kept as well.
    record.write_text("{")
    lines = make(ball, out, replace(CONFIG, seed=4))
    line(lines, f"{work / 'run'}: the unfinished run of 2 steps is kept as {work / 'run.2'}")


def test_runs_with_segments_are_kept_whole(tmp_path: Path) -> None:
    """Catches segments that are deleted one by one, and a run whose segments come from two kept runs."""
    ball = write_ball_capture(tmp_path / "ball", cameras=4, frames=9, size=32)
    out, work = tmp_path / "scene.4dv", tmp_path / "scene.work"
    segments = replace(CONFIG, segments=SegmentConfig(frames=6, overlap=2))
    make(ball, out, segments)
    before, scene = contents(work / "run"), out.read_bytes()
    lines = make(ball, out)
    line(lines, f"{work / 'run'}: the finished run of 4 steps is kept as {work / 'run.1'}")
    assert not (work / "run" / "segments").exists()
    lines = make(ball, out, segments)
    assert "train 000: running" not in lines
    assert contents(work / "run") == before
    assert out.read_bytes() == scene


def test_the_imported_capture_of_a_kept_run_is_kept(ball: Path, tmp_path: Path) -> None:
    """Catches a kept run whose images were replaced by another import, which would be rendered wrongly."""
    source = Path(shutil.copytree(ball, tmp_path / "source"))
    calibration = tmp_path / "calibration"
    calibration.mkdir()
    for name in ("intri.yml", "extri.yml"):
        shutil.move(source / name, calibration / name)
    out, work = tmp_path / "scene.4dv", tmp_path / "scene.work"
    imports = ImportOptions(calibration=str(calibration))
    make(source, out, imports=imports)
    pictures = [open_run(work / "run").capture.image(0, frame).copy() for frame in range(2)]
    lines = make(source, out, replace(CONFIG, seed=3), imports=replace(imports, fps=12.0))
    assert "fps: not set -> 12" in line(lines, "import: again")
    line(lines, f"{work / 'capture'}: kept as {work / 'capture.1'}")
    kept = open_run(work / "run.1")
    assert kept.config.capture == work / "capture.1"
    assert [(kept.capture.image(0, frame) == pictures[frame]).all() for frame in range(2)] == [True, True]
    assert open_run(work / "run").config.capture == work / "capture"


def test_a_folder_belongs_to_one_scene(ball: Path, tmp_path: Path) -> None:
    """Catches two scenes that replace each other's results, and a scene with a suffix that nothing reads."""
    out, work = tmp_path / "scene.4dv", tmp_path / "scene.work"
    with pytest.raises(UserError, match=r"scene\.4dw: expected a name that ends in \.4dv for a scene, got the suffix"):
        make(ball, tmp_path / "scene.4dw")
    make(ball, out)
    with pytest.raises(UserError, match=r"scene\.work: expected the folder for .*other\.4dv, got that of .*scene\.4dv"):
        make_scene(ball, tmp_path / "other.4dv", CONFIG, MatteSettings(), Context(), work=work)
    # A moved project keeps working, and so does a scene that was renamed.
    moved = tmp_path / "moved"
    moved.mkdir()
    for path in (out, work):
        shutil.move(path, moved / path.name)
    assert not any("train: running" in each for each in make(ball, moved / "scene.4dv"))
    (moved / "scene.4dv").rename(moved / "better.4dv")
    make_scene(ball, moved / "better.4dv", CONFIG, MatteSettings(), Context(), work=moved / "scene.work")
