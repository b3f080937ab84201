"""The frame rate of a capture: from --fps to the scene."""

from __future__ import annotations

import shutil
from fractions import Fraction
from pathlib import Path

import pytest

from fourd.base.errors import UserError
from fourd.cli.main import main
from fourd.reconstruction.training.run import load_run
from fourd.recording.capture import open_capture
from fourd.recording.capture.check import check_capture
from fourd.recording.capture.frame_rate import NAME, read_rate, set_rate, standard_rate, write_rate
from fourd.scene import SceneReader
from fourd.scene.bake import bake_run
from fourd.scene.playable import open_playable, select_frames, selected_rate
from tests.capture.numbered_videos import write_numbered_video
from tests.training.small import SMALL, quiet, trained_run, with_steps


@pytest.mark.parametrize(
    ("fps", "expected"),
    [
        (29.97, Fraction(30000, 1001)),
        (23.976, Fraction(24000, 1001)),
        (59.94, Fraction(60000, 1001)),
        (29.9999, Fraction(30)),
        (15.0, Fraction(15)),
        (12.5, Fraction(25, 2)),
    ],
)
def test_rates_are_exact(fps: float, expected: Fraction) -> None:
    """Catches a frame rate of 29.97 that is stored as 30, and a frame rate of 30 that is stored as 29.97."""
    assert standard_rate(fps) == expected


def test_a_stride_divides_the_rate(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a selection of every second frame that plays at twice the speed of the recording."""
    assert open_capture(ball_capture).fps is None
    capture = Path(shutil.copytree(ball_capture, tmp_path / "capture"))
    set_rate(capture, 25)
    assert open_capture(capture).fps == 25
    assert open_capture(capture, frames="0:2:2").fps == 12.5
    assert check_capture(capture).fps == 25


def test_videos_give_the_rate(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a capture of videos that has no frame rate, and a frame rate that contradicts the frame times of its
    videos."""
    for name in "ab":
        write_numbered_video(tmp_path / "videos" / f"{name}.mp4", range(10), fps=50)
    assert check_capture(tmp_path).fps == 50
    with pytest.raises(
        UserError, match=r"--fps: .*: expected image files, got videos, whose frame times give the rate"
    ):
        set_rate(tmp_path, 25)


@pytest.mark.parametrize(
    "text", ["{", "[]", '{"version": 1}', '{"version": 1, "fps": "0"}', '{"version": 1, "fps": "1/0"}']
)
def test_damaged_rates_are_reported(text: str, tmp_path: Path) -> None:
    """Catches a traceback after a manual edit of capture.json."""
    write_rate(tmp_path, Fraction(30000, 1001))
    assert read_rate(tmp_path) == Fraction(30000, 1001)
    (tmp_path / NAME).write_text(text)
    with pytest.raises(UserError, match=r"capture.json: expected .*; delete the file"):
        read_rate(tmp_path)


def test_rates_out_of_range_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a rate of 0, which would make a scene of infinite duration."""
    for command in (["synth", str(tmp_path / "a")], ["import", str(tmp_path), str(tmp_path / "b")]):
        for fps in ("0", "-25", "nan", "1e9"):
            assert main([*command, "--fps", fps]) == 2
            assert "--fps: expected 0.01 to 1000 frames per second" in capsys.readouterr().err


def test_the_import_stores_the_rate(ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches an import that ignores --fps, and an import of a capture that changes the capture's frame rate."""
    words = ["import", str(ball_capture), str(tmp_path / "first"), "--centres", "as-given"]
    assert main([*words, "--fps", "29.97"]) == 0
    assert read_rate(tmp_path / "first") == Fraction(30000, 1001)
    assert main(["import", str(tmp_path / "first"), str(tmp_path / "second"), "--centres", "as-given"]) == 0
    assert read_rate(tmp_path / "second") == Fraction(30000, 1001)
    assert main(["check", str(tmp_path / "second"), "--quick"]) == 0
    assert "at 29.97 per second" in capsys.readouterr().out
    assert main(words) == 0
    assert read_rate(tmp_path / "first") is None
    assert main(["info", str(tmp_path / "first")]) == 0
    assert "frame rate not known, plays at 30 per second" in capsys.readouterr().out


def test_runs_and_scenes_play_at_the_rate_of_the_recording(
    ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a run, a scene or a rendered video that plays at 30 frames per second although the recording has another
    rate. Also catches a scene that does not state that its rate is assumed."""
    capture = Path(shutil.copytree(ball_capture, tmp_path / "capture"))
    run = trained_run(capture, tmp_path / "run", with_steps(SMALL, 4)).folder
    for fps, expected in ((None, 30.0), (12.5, 12.5)):
        if fps is not None:
            set_rate(capture, fps)
        assert open_playable(run).fps == expected
        bake_run(load_run(run), tmp_path / "scene.4dv", quiet())
        reader = SceneReader(tmp_path / "scene.4dv")
        reader.close()
        assert (reader.manifest.fps, reader.manifest.is_fps_known) == (expected, fps is not None)
        playable = open_playable(tmp_path / "scene.4dv")
        assert selected_rate(playable, select_frames(playable, "0:3:2")) == expected / 2
        capsys.readouterr()
        assert main(["info", str(tmp_path / "scene.4dv")]) == 0
        text = capsys.readouterr().out
        assert f"3 at {expected:g} per second, {3 / expected:.2f} s" in text
        assert ("assumed: the scene does not state the recording's rate" in text) == (fps is None)
