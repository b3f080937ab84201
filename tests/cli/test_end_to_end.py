"""Tests that run all commands in sequence on a small synthetic capture, as a user would type them."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from fourd.base.formats.ply import write_ply
from fourd.cli.main import main
from fourd.recording.capture import open_capture
from fourd.scene import SceneReader, SceneWriter, open_scene
from fourd.scene.scene import make_frame
from tests.captures import sphere
from tests.processes.forked import run_together

OVERLAY = """\
points: 3000
checkpoint_steps: 20
model: {hidden: 16, planes: {levels: 2, features: 4, base_resolution: 16}}
"""


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cli") / "capture"
    assert main(["synth", str(folder), "--frames", "3", "--cameras", "9", "--size", "96"]) == 0
    return folder


@pytest.fixture(scope="module")
def made(capture: Path) -> Path:
    """A scene made by ``fourd make``. The run of the scene is in scene.work/run."""
    scene, overlay = capture.parent / "scene.4dv", capture.parent / "small.yaml"
    overlay.write_text(OVERLAY)
    words = ["make", capture, "-o", scene, "--config", overlay, "--test-views", "02,05", "--max-steps", "40"]
    assert main([*(str(word) for word in words), "--tier", "none"]) == 0
    return scene


def test_check_accepts_synthetic_captures(capture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a synthetic capture that fourd check rejects, or whose mattes do not verify its right calibration."""
    assert main(["check", str(capture), "--deep"]) == 0
    assert "Good to use; the mattes verify the calibration" in capsys.readouterr().out


def test_run_and_exported_scene_score_the_same(made: Path, tmp_path: Path) -> None:
    """Catches an export that lowers the PSNR by more than 0.1 dB."""
    run = made.with_suffix(".work") / "run"
    assert main(["eval", str(run), "--json", str(tmp_path / "run.json")]) == 0
    assert main(["eval", str(run), "--scene", str(made), "--json", str(tmp_path / "scene.json")]) == 0
    live, baked = (json.loads((tmp_path / name).read_text()) for name in ("run.json", "scene.json"))
    assert live["cameras"] == ["02", "05"]
    assert live["frames"] == [0, 1, 2]
    assert live["box"]["lpips"] is None
    assert live["box"]["psnr"] > 15
    assert baked["box"]["psnr"] > live["box"]["psnr"] - 0.1


def test_a_held_out_view_can_be_left_out_of_the_scores(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches an exclusion that is ignored, that evaluates training views, or that takes one for a held-out view."""
    run, scores = made.with_suffix(".work") / "run", tmp_path / "run.json"
    words = ["eval", str(run), "--scene", str(made), "--json", str(scores)]
    assert main([*words, "--exclude-views", "2"]) == 0
    assert json.loads(scores.read_text())["cameras"] == ["05"]
    capsys.readouterr()
    assert main([*words, "--exclude-views", "03"]) == 2
    assert "--exclude-views: expected camera names among 02, 05, got '03'" in capsys.readouterr().err


def test_full_scenes_are_scored_on_whole_pictures(capture: Path, made: Path, tmp_path: Path) -> None:
    """Catches an evaluation that compares a full scene with the object on black."""
    reader, views = SceneReader(made), open_capture(capture)
    nothing = make_frame({name: array[:0] for name, array in reader.read(0).arrays.items()})
    with SceneWriter(tmp_path / "full.4dv", replace(reader.manifest, kind="full")) as writer:
        writer.add_background(nothing)
        for frame in range(reader.manifest.frame_count):
            writer.add_frame(frame, reader.read(frame))
    words = ["eval", made.with_suffix(".work") / "run", "--scene", tmp_path / "full.4dv", "--views", "02"]
    assert main([str(word) for word in [*words, "--json", tmp_path / "full.json"]]) == 0
    index, expected = views.names.index("02"), []
    with open_scene(tmp_path / "full.4dv") as scene:
        for frame in range(views.frame_count):
            rendered = scene.render(views.cameras[index], frame).rgb
            expected.append(-10 * np.log10(np.square(rendered - views.image(index, frame) / 255.0).mean()))
    scores = json.loads((tmp_path / "full.json").read_text())
    assert scores["image"]["psnr"] == pytest.approx(np.mean(expected), abs=1e-3)


def test_make_writes_full_scenes(capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a stage that drops the background, and an export that loses quality of the background."""
    scene, overlay, shell = tmp_path / "full.4dv", tmp_path / "small.yaml", tmp_path / "shell.ply"
    xyz = 5 * sphere(2500)
    write_ply(shell, xyz, np.full(xyz.shape, 128, np.uint8))
    overlay.write_text(OVERLAY + "background: {planes: {levels: 2, features: 4, time: false}, window_px: 48}\n")
    words = ["make", capture, "-o", scene, "--config", overlay, "--test-views", "02,05", "--max-steps", "40"]
    assert main([str(word) for word in [*words, "--scene", "full", "--background", shell]]) == 0
    assert main(["info", str(scene)]) == 0
    assert "2,500 points, stored once" in capsys.readouterr().out
    run, truth = scene.with_suffix(".work") / "run", capture / "truth" / "bgs"
    assert main(["eval", str(run), "--plates", str(truth), "--json", str(tmp_path / "run.json")]) == 0
    assert main(["eval", str(run), "--scene", str(scene), "--json", str(tmp_path / "scene.json")]) == 0
    live, baked = (json.loads((tmp_path / f"{name}.json").read_text()) for name in ("run", "scene"))
    assert sorted(live["background"]) == ["02", "05"]
    assert live["image"]["psnr"] == pytest.approx(baked["image"]["psnr"], abs=0.3)
    assert live["image"]["psnr"] > 15
    assert live["covisible"] == pytest.approx(np.mean([each["covisible"] for each in live["pictures"]]))
    assert live["covisible"] == pytest.approx(baked["covisible"], abs=0.3)


def test_commands_on_one_run_at_the_same_time_agree(made: Path, tmp_path: Path) -> None:
    """Catches commands that read or delete each other's frames because they share a scratch folder."""
    run = made.with_suffix(".work") / "run"
    assert main(["render", str(run), "--out", str(tmp_path / "alone"), "--views", "02"]) == 0
    words = [
        ["render", run, "--out", tmp_path / "first", "--views", "02"],
        ["render", run, "--out", tmp_path / "second", "--views", "02"],
        ["export", run, "-o", tmp_path / "exported.4dv"],
    ]
    results = run_together([["fourd.cli.main", *(str(word) for word in each)] for each in words], tmp_path)
    assert [(result.returncode, result.stderr) for result in results if result.returncode] == []
    for frame in range(3):
        alone, first, second = (
            (tmp_path / name / "02" / f"{frame:06d}.png").read_bytes() for name in ("alone", "first", "second")
        )
        assert alone == first == second
    assert (tmp_path / "exported.4dv").read_bytes() == made.read_bytes()
    leftovers = {path.name.split("-")[0] for path in (run / "scratch").glob("*")}
    assert leftovers <= {str(os.getpid())}, "each command removes its own folder"


def test_export_of_a_run_for_other_programs(made: Path, tmp_path: Path) -> None:
    """Catches a command that does not accept a run without an exported scene, and a temporary scene that is not
    removed.
    """
    run, out = made.with_suffix(".work") / "run", tmp_path / "splats"
    assert main(["export", str(run), "-o", str(out), "--to", "splat"]) == 0
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["splats"]
    assert len(list(out.iterdir())) == 3


def test_export_packs_scenes(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches an export that ignores its tier, leaves temporary files, or names a temporary file in its error."""
    run, out = made.with_suffix(".work") / "run", tmp_path / "packed.4dv"
    assert main(["export", str(run), "-o", str(out), "--max-mbps", "0.001"]) == 2
    assert "--max-mbps: expected at least" in (error := capsys.readouterr().err)
    assert str(out) in error
    assert list(tmp_path.iterdir()) == []
    for tier in ("video", "stream"):
        assert main(["export", str(run), "-o", str(out), "--tier", tier]) == 0
        encoding = SceneReader(out).manifest.encoding
        assert encoding is not None
        assert encoding.tier == tier
        assert ("PSNR of the colours in the source views" in capsys.readouterr().err) == (tier == "video")
    assert [path.name for path in tmp_path.iterdir()] == ["packed.4dv"]
    assert out.stat().st_size < made.stat().st_size / 2


def test_render_writes_views_paths_and_videos(made: Path, tmp_path: Path) -> None:
    """Catches rendered images that are empty, have the wrong size or are in the wrong folder."""
    run = made.with_suffix(".work") / "run"
    assert main(["render", str(run), "--out", str(tmp_path / "run"), "--views", "02", "--frames", "1:2"]) == 0
    assert main(["render", str(made), "--out", str(tmp_path / "scene"), "--views", "02", "--frames", "1:2"]) == 0
    live, baked = (cv2.imread(str(tmp_path / name / "02" / "000001.png")) for name in ("run", "scene"))
    assert live is not None
    assert baked is not None
    assert live.shape == (96, 96, 3)
    assert float(np.abs(live.astype(float) - baked).mean()) < 1
    video = tmp_path / "orbit.mp4"
    words = ["render", made, "--out", video, "--path", "orbit", "--steps", "5", "--size", "64", "48"]
    assert main([str(word) for word in words]) == 0
    with av.open(str(video)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == 5
    assert frames[0].shape == (48, 64, 3)
    assert frames[0].max() > 100


def test_info_describes_every_output(capture: Path, made: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a file type that fourd info does not recognise."""
    run = made.with_suffix(".work") / "run"
    for path, title in (
        (made, "a 4D scene"),
        (capture, "a multi-view capture"),
        (run, "a training run"),
        (run / "hull" / "000000.ply", "points"),
        (next(run.glob("checkpoints/*.safetensors")), "a checkpoint"),
    ):
        assert main(["info", str(path)]) == 0
        assert title in " ".join(capsys.readouterr().out.split())


def test_help_of_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a listed command that cannot be imported."""
    from fourd.cli.main import COMMANDS

    for command in COMMANDS:
        with pytest.raises(SystemExit) as ended:
            main([command, "--help"])
        assert ended.value.code == 0
        assert f"usage: fourd {command}" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["render", "a.4dv", "--out", "x.mp4", "--layer", "3"],
            "Unrecognized options: --layer, 3; did you mean --layers?",
        ),
        (["train", "capture", "--out", "run", "--max-steps", "many"], "--max-steps"),
        (["eval"], "expected RUN, got none"),
        (["train"], "expected CAPTURE and --out PATH, got none"),
        (["train", "capture", "--out"], "-o/--out: expected a value, got none"),
    ],
)
def test_mistyped_options_are_one_line(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches tyro's multi-line box, which scripts cannot read."""
    assert main(words) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert error.startswith(f"fourd {words[0]}: ")
    assert message in error


def test_usage_errors_are_one_line_and_exit_2(capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a traceback or a page of usage for a mistyped command."""
    assert main(["trian"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "did you mean 'train'?" in error
