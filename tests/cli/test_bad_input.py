"""Tests that wrong input gives exit code 2 and one line on stderr that names the file, and that no data is lost."""

from __future__ import annotations

import json
import re
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from safetensors.torch import load_file

from fourd.cli.main import main
from fourd.reconstruction.training.run import Run, load_run
from fourd.scene.bake import bake_run
from tests.training.small import quiet, trained_run

SMALL_MODEL = "model: {hidden: 16, planes: {levels: 2, features: 4, base_resolution: 16}}\npoints: 1500\n"


@pytest.fixture(scope="module")
def trained(ball_capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Run:
    return trained_run(ball_capture, tmp_path_factory.mktemp("bad") / "run")


@pytest.fixture(scope="module")
def scene(trained: Run) -> Path:
    path = trained.folder.parent / "scene.4dv"
    bake_run(load_run(trained.folder), path, quiet())
    return path


def error_line(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The single error line of a command that exits with 2."""
    assert main([str(word) for word in words]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("fourd ")]
    assert len(lines) == 1
    return lines[0]


def test_mistyped_config_keys_are_refused(
    ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a setting that the command silently ignores."""
    overlay = tmp_path / "my.yaml"
    overlay.write_text("model:\n  neighbors: 3\n")
    words = ["train", ball_capture, "--out", tmp_path / "run", "--config", overlay, "--max-steps", 1]
    line = error_line(capsys, *words)
    assert re.search(r"my.yaml.*neighbors.*neighbours", line)
    assert not (tmp_path / "run").exists()


def test_other_folders_are_not_used_as_runs(
    ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches checkpoints that are written into a folder with a user's own files."""
    (tmp_path / "thesis.tex").write_text("mine")
    line = error_line(capsys, "train", ball_capture, "--out", tmp_path, "--max-steps", 1)
    assert "expected a new or empty folder, got other files; name another folder with --out" in line
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]
    assert "expected a run (a folder with config.yaml), got none" in error_line(capsys, "eval", tmp_path)


def test_truncated_scenes_are_refused(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a crash of the viewer after an interrupted download."""
    cut = tmp_path / "cut.4dv"
    cut.write_bytes(scene.read_bytes()[:-1000])
    for words in (("info", cut), ("render", cut, "--out", tmp_path / "out", "--path", "orbit")):
        assert "cut.4dv" in error_line(capsys, *words)
    assert not (tmp_path / "out").exists()


def test_checkpoints_of_another_model_are_refused(
    trained: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches weights of another model that are loaded because their shapes match, and a torch traceback."""
    other = Path(shutil.copytree(trained.folder, tmp_path / "run"))
    config = other / "config.yaml"
    config.write_text(re.sub(r"hidden: 16", "hidden: 24", config.read_text()))
    line = error_line(capsys, "eval", other)
    assert "expected a checkpoint of this model, got one of another" in line
    assert "safetensors" in line


@pytest.mark.parametrize("kind", ["missing", "truncated", "mask size"])
def test_damaged_captures_are_refused(
    kind: str, ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches training on a truncated image. Other errors of the reader are covered in the reader's own tests."""
    capture = Path(shutil.copytree(ball_capture, tmp_path / "capture"))
    picture = capture / "images" / "05" / "000001.png"
    if kind == "missing":
        picture.unlink()
    elif kind == "truncated":
        picture.write_bytes(picture.read_bytes()[:-100])
    else:
        picture = capture / "masks" / "05" / "000001.png"
        cv2.imwrite(str(picture), np.zeros((10, 10), np.uint8))
    line = error_line(capsys, "make", capture, "-o", tmp_path / "scene.4dv", "--max-steps", 1)
    assert str(picture) in line or "000001.png" in line
    assert not (tmp_path / "scene.4dv").exists()


def test_empty_hulls_name_the_inconsistent_views(
    ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches an empty point cloud that causes an error only later, in training."""
    capture = Path(shutil.copytree(ball_capture, tmp_path / "capture"))
    for frame in range(3):
        for camera in ("02", "05"):
            matte = np.zeros((64, 64), np.uint8)
            matte[2:8, 2:8] = 255
            cv2.imwrite(str(capture / "masks" / camera / f"{frame:06d}.png"), matte)
    line = error_line(capsys, "carve", capture, "-o", tmp_path / "hulls", "--agreement", "1.0")
    assert "02" in line
    assert "05" in line
    assert "hull" in line


def test_unwritable_outputs_are_named(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a traceback if a parent folder of the output is a file."""
    (tmp_path / "taken").write_text("mine")
    line = error_line(capsys, "render", scene, "--views", "03", "--out", tmp_path / "taken" / "pictures")
    assert "taken" in line
    assert (tmp_path / "taken").read_text() == "mine"


def test_full_disk_keeps_the_previous_checkpoint(trained: Run, tmp_path: Path) -> None:
    """Catches a checkpoint that is lost because the new checkpoint overwrites it in place. The file size is limited to
    40 kB, which is less than a checkpoint needs."""
    run = Path(shutil.copytree(trained.folder, tmp_path / "run"))
    capture = str(trained.capture.path)
    before = load_file(run / "checkpoints" / "00000006.safetensors")

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))

    code = (
        "import signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "from fourd.cli.main import main; sys.exit(main(sys.argv[1:]))"
    )
    words = [sys.executable, "-c", code, "train", capture, "--out", str(run), "--resume", "--max-steps", "9"]
    done = subprocess.run(words, capture_output=True, text=True, preexec_fn=limit)
    assert done.returncode == 2, done.stderr
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("fourd train: ")
    assert "checkpoint" in last
    assert load_run(run).step == 6
    after = load_file(run / "checkpoints" / "00000006.safetensors")
    assert all((before[name] == after[name]).all() for name in before)


def test_colours_of_held_out_cameras_need_fitted_poses(
    trained: Run, scene: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a flag that is silently ignored."""
    line = error_line(capsys, "eval", trained.folder, "--refine-test-colours")
    assert "--refine-test-colours: expected also --refine-test, got only --refine-test-colours" in line
    line = error_line(capsys, "eval", trained.folder, "--refine-test", "--refine-test-colours", "--scene", scene)
    assert "--refine-test-colours: expected no --scene, got both options; remove one of them" in line


def test_scores_of_fitted_cameras_are_marked(trained: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a report that does not mark scores of cameras that were fitted before the evaluation."""
    assert main(["eval", str(trained.folder), "--refine-test", "--json", str(tmp_path / "fitted.json")]) == 0
    assert "03: fitted to its own images before evaluation" in capsys.readouterr().out
    content = json.loads((tmp_path / "fitted.json").read_text())
    assert list(content["fitted_to_own_pictures"]) == ["03"]
    assert content["fitted_to_own_pictures"]["03"]["colours"] is None


def test_resumed_runs_keep_their_config(trained: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a resumed run that silently ignores a changed flag, or rejects unchanged flags."""
    run = Path(shutil.copytree(trained.folder, tmp_path / "run"))
    words = ["train", trained.capture.path, "--out", run, "--resume", "--max-steps", 7]
    for flag, shown in ((["--points", 5], "points: 5"), (["--set", "rates.planes=1"], "planes: 1.0")):
        line = error_line(capsys, *words, *flag)
        assert f"--resume: expected the options of the run, except for the budget, got {shown}; train in a new" in line
    same = ["--points", 1500, "--seed", 0, "--test-views", "03", "--set", "layers=8"]
    assert main([str(word) for word in [*words, *same]]) == 0
    assert load_run(run).step == 7
