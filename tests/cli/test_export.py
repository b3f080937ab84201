"""The command `fourd export --to`, and commands that open its files."""

from __future__ import annotations

from pathlib import Path

import pytest

from fourd.cli.main import main
from tests.baking.scenes import write_scene


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    write_scene(tmp_path / "scene.4dv")
    return tmp_path / "scene.4dv"


def export(*words: object) -> int:
    """Run `fourd export` and return its exit code."""
    return main(["export", *map(str, words)])


def test_other_commands_open_the_exported_files(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches files that fourd itself cannot open, and a selection of frames that is ignored."""
    out = tmp_path / "splats"
    assert export(scene, "-o", out, "--to", "ply-sequence", "--frames", "10:13:2") == 0
    assert "2 frames" in capsys.readouterr().err
    assert [file.name for file in sorted(out.iterdir())] == ["frame_000010.ply", "frame_000012.ply"]
    assert main(["info", str(out)]) == 0
    assert "200 to 202 per frame" in capsys.readouterr().out
    picture = tmp_path / "picture.png"
    assert main(["view", str(out), "--screenshot", str(picture), "--renderer", "cpu", "--size", "64", "48"]) == 0
    assert main(["render", str(out), "--path", "orbit", "-o", str(tmp_path / "orbit"), "--steps", "2"]) == 0
    assert picture.stat().st_size > 100
    assert len(list((tmp_path / "orbit").iterdir())) == 2


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--to", "glb", "--tier", "full"], "--to: expected no --tier and no --max-mbps, got at least one"),
        (["--to", "glb", "--degree", "4"], "--degree: expected 0 to 3, got 4"),
        (["--to", "glb", "--frames", "20:22"], "--frames: expected"),
        ([], "expected a run's folder, got a file; add --to FORMAT"),
    ],
)
def test_wrong_options_are_refused(
    scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    """Catches options that are ignored, and an export of frames that do not exist."""
    assert export(scene, "-o", tmp_path / "out", *words) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_one_file_takes_one_frame(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches an export that writes all frames to one file, so that only the last frame remains."""
    assert export(scene, "-o", tmp_path / "a.glb", "--to", "glb") == 2
    assert "a.glb: expected a folder for 3 frames, got the name of a file" in capsys.readouterr().err
    assert export(scene, "-o", tmp_path / "a.glb", "--to", "glb", "--frames", "11:12") == 0
    assert (tmp_path / "a.glb").is_file()


def test_one_frame_of_usd_is_one_file(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a file that is written before the command fails."""
    pytest.importorskip("pxr")
    assert export(scene, "-o", tmp_path / "one.usdc", "--to", "usd", "--frames", "11:12") == 0
    assert "one.usdc: 1 frame" in capsys.readouterr().err
    assert export(scene, "-o", tmp_path / "two.usda", "--to", "usd", "--frames", "10:12") == 0
    names = sorted(path.name for path in tmp_path.iterdir() if path != scene)
    assert names == ["one.usdc", "two.usda", "two_frames"]
    assert export(scene, "-o", tmp_path / "three.usdz", "--to", "usd") == 2
    assert "three.usdz: expected a folder or a file .usdc for --to usd, got .usdz" in capsys.readouterr().err


def test_broken_splats_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a traceback for an incomplete file of another program."""
    (tmp_path / "a.splat").write_bytes(b"0" * 40)
    for command in (["view", "--screenshot", tmp_path / "a.png"], ["info"]):
        assert main([command[0], str(tmp_path / "a.splat"), *map(str, command[1:])]) == 2
        assert "a.splat: expected a multiple of 32 bytes, got 40 bytes" in capsys.readouterr().err
