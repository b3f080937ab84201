"""Captures with masks of some cameras: the others get the silhouettes of the visual hull."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.base.errors import UserError
from fourd.base.files import sort_names
from fourd.cli.main import main
from fourd.pipeline.stages import check
from fourd.recording.capture import open_capture
from fourd.recording.capture.check import check_capture
from fourd.recording.capture.split import write_test_views

UNMASKED = ("02", "05")


@pytest.fixture
def capture(ball_capture: Path, tmp_path: Path) -> Path:
    """A capture without masks of two cameras, of which one is in the test split."""
    path = Path(shutil.copytree(ball_capture, tmp_path / "capture"))
    for name in UNMASKED:
        shutil.rmtree(path / "masks" / name)
    write_test_views(path, ["05"])
    return path


def overlap(matte: Path, truth: Path) -> float:
    first, second = (cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) > 127 for path in (matte, truth))
    return float((first & second).sum() / (first | second).sum())


def test_make_uses_the_masks_that_exist(
    capture: Path, ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a capture that is refused because the test cameras have no masks, mattes that are made in spite of masks,
    and a test split that is trained on."""
    out = tmp_path / "scene.4dv"
    small = ["--max-steps", "2", "--points", "400", "--workers", "1", "--set", "layers=4"]
    assert main(["make", str(capture), "-o", str(out), *small]) == 0
    log = " ".join(capsys.readouterr().out.split())
    assert "held out: 05, the test split in" in log
    assert "no masks of 02, 05; their mattes are the silhouettes of the visual hull of the masks of 6 other" in log
    mattes = capture / ".fourd" / "mattes"
    assert sort_names(path.name for path in mattes.iterdir()) == list(UNMASKED)
    for name in UNMASKED:
        assert overlap(mattes / name / "000001.png", ball_capture / "masks" / name / "000001.png") > 0.7
    assert main(["eval", str(tmp_path / "scene.work" / "run")]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "inside the matte's box" in shown
    assert "05: no masks, so the matte's box is that of mattes made from other cameras' masks" in shown


def test_masks_of_held_out_cameras_do_not_influence_mattes(
    capture: Path, ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches masks of held-out cameras that shape the mattes of training cameras."""
    arguments = ["make", str(capture), "-o", str(tmp_path / "s.4dv"), "--max-steps", "1", "--points", "200"]
    assert main([*arguments, "--workers", "1", "--test-views", "0,1"]) == 0
    assert "the masks of 4 other cameras" in " ".join(capsys.readouterr().out.split())


def test_check_and_readers_accept_missing_masks(capture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a check that counts missing masks of a camera as a problem, or does not name the camera."""
    report = check_capture(capture)
    assert report.problems == ()
    assert sorted(set(report.cameras) - set(report.masked)) == list(UNMASKED)
    assert report.test_views == ("05",)
    assert main(["check", "--quick", str(capture)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "masks of 6 of 8 cameras; fourd make, train and matte make mattes of the others: 02, 05" in shown
    assert "05 by default (test split)" in shown
    assert main(["info", str(capture)]) == 0
    assert "of 6 cameras, not of 02, 05" in " ".join(capsys.readouterr().out.split())
    assert main(["carve", str(capture), "--points", "200", "--workers", "1"]) == 0
    assert "not used, because these cameras have no mattes: 02, 05" in " ".join(capsys.readouterr().err.split())


def test_incomplete_masks_of_a_camera_are_refused(capture: Path) -> None:
    """Catches a camera whose masks are dropped as a whole because one frame lacks a mask."""
    (capture / "masks" / "01" / "000001.png").unlink()
    assert any("masks/01/000001.png: expected an image" in line for line in check_capture(capture).problems)
    with pytest.raises(UserError, match=r"masks/01/000001.png: expected an image"):
        open_capture(capture)


def test_selected_cameras_keep_their_images(ball_capture: Path) -> None:
    """Catches a selection of cameras that returns cached images of the cameras before the selection."""
    with open_capture(ball_capture) as whole:
        assert np.array_equal(whole.image(0, 0), whole.select([0]).image(0, 0))
        part = whole.select([3, 1])
        assert part.names == (whole.names[3], whole.names[1])
        assert np.array_equal(part.image(0, 0), whole.image(3, 0))
        assert np.array_equal(part.mask(1, 0), whole.mask(1, 0))


def test_warnings_of_the_check_are_logged(
    capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches a pipeline that uses suspicious poses without a word, because only problems are reported."""
    report = replace(
        check_capture(capture), warnings=("extri.yml: suspicious",), problems=("extri.yml: wrong; fix it",)
    )
    monkeypatch.setattr(check, "check_capture", lambda *_, **__: report)
    assert main(["make", str(capture), "-o", str(tmp_path / "s.4dv"), "--max-steps", "1", "--workers", "1"]) == 2
    output = capsys.readouterr()
    assert "warning: extri.yml: suspicious" in output.out
    assert "extri.yml: wrong; fix it" in output.err
