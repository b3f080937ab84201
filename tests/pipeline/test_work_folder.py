"""Tests of the folder for intermediate results, with stages that take no time."""

from __future__ import annotations

import io
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest
from rich.console import Console

from fourd.base.errors import UserError
from fourd.base.storage import parse_location
from fourd.pipeline.runner import AnyStage, Runner
from fourd.pipeline.stage import Context, Leftovers, Stage
from fourd.pipeline.stages import mattes
from fourd.pipeline.work.kept import keep_run, kept_folders
from fourd.recording.matting.output import MatteState
from fourd.recording.matting.sequence import MatteSettings


@dataclass(frozen=True)
class FakeFiles:
    run: Path
    capture: Path


@dataclass(frozen=True)
class CarveChoice:
    test_views: tuple[str, ...] = ()


@dataclass(frozen=True)
class TrainChoice:
    max_steps: int = 10
    test_views: tuple[str, ...] = ()


def carve(files: FakeFiles, settings: CarveChoice, context: Context) -> None:
    (files.run / "hull").mkdir(parents=True, exist_ok=True)
    (files.run / "hull" / "000000.ply").write_text(str(settings))


def train(files: FakeFiles, settings: TrainChoice, context: Context) -> None:
    points = (files.run / "hull" / "000000.ply").read_text()
    checkpoint = files.run / "checkpoints" / f"{settings.max_steps:06d}.safetensors"
    checkpoint.parent.mkdir(exist_ok=True)
    checkpoint.write_text(f"{settings} from {points}")


def bake(files: FakeFiles, settings: CarveChoice, context: Context) -> None:
    (files.run.parent.parent / "scene.4dv").write_text(checkpoints(files.run))


def checkpoints(run: Path) -> str:
    return " ".join(path.read_text() for path in sorted((run / "checkpoints").iterdir()))


def stages(work: Path, views: tuple[str, ...] = (), steps: int = 10) -> list[AnyStage]:
    """A stage that writes the points of a run, a stage that trains it, and a stage that bakes it."""
    run = work / "run"
    files = FakeFiles(run, work / "capture")
    return [
        Stage("carve", carve, files, CarveChoice(views), outputs=(run / "hull",), leftovers=(Leftovers(run),)),
        Stage(
            "train",
            train,
            files,
            TrainChoice(steps, views),
            outputs=(run / "checkpoints",),
            leftovers=(Leftovers(run, keep=("hull",)),),
            after=("carve",),
            starts_run=True,
        ),
        Stage("bake", bake, files, CarveChoice(), outputs=(work.parent / "scene.4dv",), after=("train",)),
    ]


def make(given: list[AnyStage], *, force: bool = False, stop: str = "") -> str:
    """Run the stages up to the stage named ``stop``, and return what is printed."""
    text = io.StringIO()
    record = given[0].files.run.parent / "stages.json"
    record.parent.mkdir(exist_ok=True)
    runner = Runner(Context(Console(file=text, width=1000)), record, force=force)
    runner.run([stage for stage in given if stage.name != stop])
    return text.getvalue()


def test_runs_are_kept_and_used_again(tmp_path: Path) -> None:
    """Catches a trained run that is deleted or trained again, and a scene that is baked from another run."""
    work, scene = tmp_path / "scene.work", tmp_path / "scene.4dv"
    choices = [(("05",), 10), ((), 10), ((), 20), (("05",), 20)]
    made = []
    for views, steps in choices:
        make(stages(work, views, steps))
        made.append(scene.read_text())
    assert len(set(made)) == 4
    assert [path.name for path in kept_folders(work / "run")] == ["run.3", "run.2", "run.1"]
    for number in (0, 3, 1, 2, 2, 0):
        printed = make(stages(work, *choices[number]))
        assert "train: running" not in printed
        assert scene.read_text() == made[number] == checkpoints(work / "run")
    assert len(kept_folders(work / "run")) == 3


def test_changes_are_named_with_their_old_and_new_values(tmp_path: Path) -> None:
    """Catches a run that is replaced without a word about the setting that differs, and about what becomes of it."""
    work = tmp_path / "scene.work"
    assert "again" not in make(stages(work, ("05", "11"), 1854))
    lines = make(stages(work, (), 1854)).splitlines()
    assert lines[0] == "carve: again, because test views: 05, 11 -> none"
    assert lines[1].startswith(f"{work}/run: the finished run of 1,854 steps is kept as {work}/run.1 (0.0 MB); ")
    lines = make(stages(work, (), 2000), force=True).splitlines()
    assert lines[1] == "train: again, because max steps: 1854 -> 2000"
    assert lines[2] == f"{work}/run: the finished run of 1,854 steps is deleted, because of --force"
    assert [path.name for path in kept_folders(work / "run")] == ["run.1"]


def test_an_interrupted_change_loses_nothing(tmp_path: Path) -> None:
    """Catches a run that is trained again, because a command with other settings was interrupted before training."""
    work, scene = tmp_path / "scene.work", tmp_path / "scene.4dv"
    make(stages(work, ("05",)))
    first = scene.read_text()
    given = stages(work)
    make(given[:1])
    assert not (work / "run" / "checkpoints").exists()
    assert "train: running" not in make(stages(work, ("05",)))
    assert scene.read_text() == first
    assert kept_folders(work / "run") == [], "the run of the interrupted command had no checkpoint"


def test_the_subfolders_that_stay_have_their_files_twice(tmp_path: Path) -> None:
    """Catches a kept run whose points are changed by the run that takes its place."""
    run = tmp_path / "run"
    for name in ("hull", "checkpoints"):
        (run / name).mkdir(parents=True)
        (run / name / "file").write_text(name)
    kept = keep_run(run, ("hull", "background"))
    assert kept == tmp_path / "run.1"
    assert [path.name for path in run.iterdir()] == ["hull"]
    os.replace(kept / "checkpoints" / "file", run / "hull" / "file")
    assert (kept / "hull" / "file").read_text() == "hull"
    (tmp_path / "run.old").mkdir()
    assert keep_run(run, ()) == tmp_path / "run.2"
    assert not run.exists()


@pytest.mark.parametrize("other", ["s3://bucket/scene.4dv", "other.4dv", "../scene.4dv"])
def test_a_folder_belongs_to_one_scene(other: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches two scenes that use one folder and replace each other's results."""
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    work, scene = Path("scene.work"), Path("scene.4dv")
    runner = Runner(Context(), work / "stages.json")
    runner.claim(scene)
    work.mkdir()
    runner.run(stages(work))
    for same in (scene, scene.absolute(), Path("..") / "here" / "scene.4dv"):
        Runner(Context(), work / "stages.json").claim(same)
    with pytest.raises(UserError, match=r"scene\.work: expected the folder for .*, got that of scene\.4dv; name this"):
        Runner(Context(), work / "stages.json").claim(parse_location(other))
    scene.rename("gone.4dv")
    Runner(Context(), work / "stages.json").claim(Path("gone.4dv"))


def test_mattes_that_were_corrected_by_hand_are_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches mattes that are replaced without a word after a change of a file, although the user has edited them."""
    made = ["first"]

    def make_mattes(selection: object, settings: object, workers: int, track: object) -> int:
        """Stands for the stage: it replaces the mattes if their key has changed."""
        if MatteState.read(tmp_path).key != made[-1]:
            shutil.rmtree(folder, ignore_errors=True)
            (folder / "00").mkdir(parents=True)
            (folder / "00" / "000000.png").write_text(made[-1])
            (tmp_path / ".fourd" / "mattes.png").write_text("the sheet is newer")
            MatteState(made[-1], None).write(tmp_path)
        return 0

    folder = tmp_path / ".fourd" / "mattes"
    (tmp_path / ".fourd").mkdir()
    (tmp_path / ".fourd" / "mattes.png").write_text("")
    monkeypatch.setattr(mattes, "make_mattes", make_mattes)
    monkeypatch.setattr(mattes, "index_capture", lambda *_: None)
    files, settings = mattes.MatteFiles(tmp_path), mattes.MatteStageSettings(None, None, MatteSettings())

    def run() -> str:
        text = io.StringIO()
        mattes.run_mattes(files, settings, Context(Console(file=text, width=1000)))
        return text.getvalue()

    for _ in range(2):
        assert "made again" not in run()
    made.append("second")
    assert run().startswith(f"{folder}: made again, because settings or files have changed\n")
    assert not (folder.parent / "mattes.1").exists(), "nobody has edited the first mattes"
    (folder / "00" / "000000.png").write_text("edited")
    os.utime(tmp_path / ".fourd" / "mattes.png", (1, 1))
    assert "made again" not in run()
    made.append("third")
    printed = run()
    assert f"{folder}: made again, because settings or files have changed" in printed
    assert f"1 of the earlier mattes were edited after fourd had made them; all are kept as {folder}.1" in printed
    assert (folder / "00" / "000000.png").read_text() == "third"
    assert (folder.parent / "mattes.1" / "00" / "000000.png").read_text() == "edited"
    assert "made again" not in run()
    assert sorted(path.name for path in folder.parent.iterdir()) == [
        "mattes", "mattes.1", "mattes.json", "mattes.png",
    ]  # fmt: skip
