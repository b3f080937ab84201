"""How ``--background`` and the other training options override the config."""

from __future__ import annotations

from pathlib import Path

import pytest

from fourd.base.errors import UserError
from fourd.cli.main import main
from fourd.cli.training_options import TrainingOptions
from fourd.pipeline.graphs.run import RunRequest
from fourd.reconstruction.training.config import TrainConfig


def config(background: str | None, file: Path | None = None, *assignments: str) -> TrainConfig:
    return TrainingOptions(background=background, config=file, assignments=assignments, max_steps=1).train_config()


@pytest.mark.parametrize("method", ["ngp", "sfm"])
def test_a_method_replaces_the_points_of_the_config_file(method: str, tmp_path: Path) -> None:
    """Catches a flag for the seeding method that has no effect if the config file names a file of points."""
    (tmp_path / "a.yaml").write_text("background: {seeds: own.ply, seeding: sfm}\n")
    background = config(method, tmp_path / "a.yaml").background
    assert background.seeding == method
    assert background.seeds is None


def test_own_points_are_a_ply_file(tmp_path: Path) -> None:
    """Catches a file that is used as a method name, and a file that is rejected because of its name."""
    assert config("dir/own.PLY").background.seeds == Path("dir/own.PLY")
    (tmp_path / "own").write_text("ply\n")
    assert config(str(tmp_path / "own")).background.seeds == tmp_path / "own"


def test_flags_not_given_change_nothing(tmp_path: Path) -> None:
    """Catches a flag that is not given but whose default overrides the config file."""
    (tmp_path / "a.yaml").write_text("background: {seeding: sfm, points: 5, radiance: {steps: 7}}\n")
    background = config(None, tmp_path / "a.yaml").background
    assert (background.seeding, background.points, background.radiance.steps) == ("sfm", 5, 7)
    assert config(None).background.seeding == "ngp"


def test_neither_a_method_nor_a_file_is_refused() -> None:
    """Catches a mistyped method that is only reported after the mattes are made."""
    with pytest.raises(UserError, match=r"--background: expected ngp, sfm or a PLY file, got 'nerf'; see .* --help$"):
        config("nerf")


@pytest.mark.parametrize("command", ["train", "make"])
def test_both_commands_refuse_it(command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a command that defines ``--background`` differently from the other commands."""
    assert main([command, str(tmp_path), "-o", str(tmp_path / "out"), "--scene", "full", "--background", "nerf"]) == 2
    line = capsys.readouterr().err
    assert line.startswith(f"fourd {command}: --background: expected ngp, sfm or a PLY file, got 'nerf'")
    assert line.count("\n") == 1


def test_an_invalid_field_is_refused_with_its_key(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("background: {radiance: {levels: 0}}\n")
    with pytest.raises(UserError, match=r"a\.yaml.*radiance.*levels: expected 1 to 32, got 0"):
        config(None, tmp_path / "a.yaml")


def test_set_reaches_any_key_after_the_config_file(tmp_path: Path) -> None:
    """Catches a key that --set cannot reach, text where a number is expected, and a file that overrides --set."""
    (tmp_path / "a.yaml").write_text("rates: {planes: 1, mlps: 2}\n")
    words = ("rates.planes=1e-3", "model.planes.levels=3", "test_views=[05, 1e3]", "frames=1:24")
    made = config(None, tmp_path / "a.yaml", *words)
    assert (made.rates.planes, made.rates.mlps, made.model.planes.levels) == (1e-3, 2.0, 3)
    assert (made.test_views, made.frames) == (("05", "1e3"), "1:24")


def test_set_values_are_validated_together() -> None:
    """Catches keys that are only valid together but are validated one by one."""
    model = config(None, None, "model.radius_start=8", "model.radius_range=[7, 9]").model
    assert (model.radius_start, model.radius_range) == (8.0, (7.0, 9.0))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--set", "rates.plane=1"], "--set rates: expected a known key, got 'plane'; did you mean 'planes'?"),
        (["--set", "points=many"], "--set points: expected a whole number, got 'many'"),
        (["--set", "points=1000000000000000000"], "--set points: expected 1 to 16777216, got 1000000000000000000"),
        (["--set", "model.hidden=1000000000"], "--set model.hidden: expected 1 to 4096, got 1000000000"),
        (["--set", "points=0"], "--set points: expected 1 to 16777216, got 0"),
        (["--set", "points"], "--set: expected KEY=VALUE, got 'points'"),
        (["--set", "points="], "--set points: expected a value after '=', got none"),
        (["--set", "points=[1"], "--set points: expected a YAML value, got '[1'"),
        (["--set", "model=3", "--set", "model.hidden=4"], "--set model.hidden: expected keys below 'model'"),
        (["--points", "5", "--set", "points=6"], "--points, --set points: expected one of them, got both"),
        (["--points", "0"], "--points: expected 1 to 16777216, got 0"),
        (["--points", "many"], "--points: expected INT, got 'many'"),
        (["--scale", "9"], "--scale: expected more than 0 and at most 4, got 9.0"),
        (["--scene", "ful"], "--scene: expected one of 'full', 'object', got 'ful'"),
        (["--background-points", "0"], "--background-points: expected 1 to 16777216, got 0"),
        (["--frames", "5"], "--frames: expected A:B or A:B:S"),
        (["--workers", "0"], "--workers: expected at least 1, got 0"),
    ],
)
@pytest.mark.parametrize("command", ["train", "make"])
def test_bad_values_are_one_line(
    command: str, words: list[str], message: str, ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a traceback, a value that is ignored, and an error that does not name the option."""
    out = tmp_path / ("out.4dv" if command == "make" else "out")
    assert main([command, str(ball_capture), "-o", str(out), "--max-steps", "1", *words]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"fourd {command}: {message}")
    assert error.count("\n") == 1


@pytest.mark.parametrize("command", ["train", "make"])
def test_help_shows_the_defaults_of_the_config(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches an option whose default value is missing in --help."""
    with pytest.raises(SystemExit):
        main([command, "--help-all"])
    text = " ".join(capsys.readouterr().out.replace("│", " ").split())
    defaults = TrainConfig()
    for default in (defaults.points, defaults.background.points, defaults.scene, defaults.background.seeding):
        assert f"(default: {default})" in text
    assert "default: None" not in text


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--segment", "5"], "--segment: expected at least 12 with an overlap of 4 frames, got 5; change the value"),
        (["--segment", "48", "--scene", "full"], "--segment: expected scene: object, because all segments of a whole"),
        (
            ["--segment", "48", "--refine-colours"],
            "--refine-colours: segments.frames: expected no refinement of",
        ),
        (["--warm-start"], "--warm-start: expected also --segment, got only --warm-start; add --segment FRAMES"),
    ],
)
def test_segments_that_cannot_be_trained_are_refused(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches an option that is ignored, and an internal error instead of the option's name."""
    assert main(["train", str(tmp_path), "-o", str(tmp_path / "out"), "--max-steps", "1", *words]) == 2
    line = capsys.readouterr().err
    assert line.startswith(f"fourd train: {message}")
    assert line.count("\n") == 1


def test_accepted_mattes_do_not_make_a_still_scene(
    ball_capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches an option --accept-mattes that leads to a scene without foreground."""
    requests: list[RunRequest] = []

    def record(request: RunRequest) -> tuple[()]:
        requests.append(request)
        return ()

    monkeypatch.setattr("fourd.pipeline.graphs.run.stages_to_run", record)
    words = ["train", str(ball_capture), "-o", str(tmp_path / "run"), "--max-steps", "1", "--accept-mattes"]
    assert main(words) == 0
    assert (requests[0].accept_mattes, requests[0].still) == (True, False)
