"""The verdict of ``fourd check``: damaged files, a single camera, equal calibrations, and what is not verified."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.cli.main import main
from fourd.recording.capture import read_calibration, write_calibration


@pytest.fixture
def capture(ball_capture: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(ball_capture, tmp_path / "capture"))


def printed(capsys: pytest.CaptureFixture[str], code: int, *words: object) -> str:
    """The output of a command that exits with ``code``, on one line."""
    assert main([str(word) for word in words]) == code
    output = capsys.readouterr()
    return " ".join((output.out + output.err).split())


def store_as_jpeg(capture: Path) -> None:
    for path in (capture / "images").glob("*/*.png"):
        cv2.imwrite(str(path.with_suffix(".jpg")), cv2.imread(str(path)))
        path.unlink()


@pytest.mark.parametrize("missing", [1, 40, 400])
@pytest.mark.parametrize("is_zero", [False, True], ids=["cut", "zeros"])
def test_truncated_images_are_found_without_an_option(
    capture: Path, capsys: pytest.CaptureFixture[str], missing: int, is_zero: bool
) -> None:
    """Catches a truncated JPEG in a capture that is good to use."""
    store_as_jpeg(capture)
    path = capture / "images" / "03" / "000002.jpg"
    content = path.read_bytes()
    path.write_bytes(content[:-missing] + bytes(missing) * is_zero)
    output = printed(capsys, 2, "check", capture)
    assert f"fourd check: {path}: expected a complete JPEG, " in output
    assert "Good to use" not in output


def test_truncated_masks_are_found(capture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a check that decodes images, but only some of the masks."""
    for path in list((capture / "masks").glob("*/000001.png")):
        content = path.read_bytes()
        path.write_bytes(content[: len(content) // 2])
    assert "expected a complete JPEG" in printed(capsys, 2, "check", capture)


@pytest.mark.parametrize("words", ["check", "carve", "train --out run --max-steps 1", "make -o scene.4dv"])
def test_a_single_camera_is_refused(
    capture: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: str
) -> None:
    """Catches a check that accepts one camera, and the ValueError of carving that followed."""
    monkeypatch.chdir(capture.parent)
    calibration = read_calibration(capture)["00"]
    for folder in [*(capture / "images").iterdir(), *(capture / "masks").iterdir()]:
        if folder.name != "00":
            shutil.rmtree(folder)
    write_calibration(capture, ["00"], [calibration.camera(64, 64)])
    command, *options = words.split()
    output = printed(capsys, 2, command, capture, *options)
    assert "expected at least 2 cameras, got 1" in output
    assert "Good to use" not in output


def test_equal_calibrations_are_named_by_import_and_check(capture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches two cameras with equal calibrations that are imported without a word and are good to use."""
    cameras = {name: each.camera(64, 64) for name, each in read_calibration(capture).items()}
    cameras["05"] = cameras["02"]
    write_calibration(capture, list(cameras), list(cameras.values()))
    named = "cameras '02' and '05' have equal calibrations, so at most one of them is right"
    assert f"warning: {named}" in printed(capsys, 0, "import", capture, capture.parent / "out")
    output = printed(capsys, 0, "check", capture)
    assert named in output
    assert "Usable, but the calibration looks wrong for: 02, 05" in output


def test_unverified_cameras_are_not_good_to_use(capture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches "Good to use" over a calibration that no match confirms."""
    output = printed(capsys, 0, "check", capture)
    assert "verified for 0 of 8 cameras" in output
    assert "Usable, but the calibration could not be verified" in output
    quick = printed(capsys, 0, "check", capture, "--quick")
    assert "neither the calibration nor the images were checked (--quick)" in quick


def test_empty_masks_are_refused(capture: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a capture with black masks that is good to use although carving finds nothing."""
    for path in (capture / "masks").glob("*/*.png"):
        cv2.imwrite(str(path), np.zeros((64, 64), np.uint8))
    output = printed(capsys, 2, "check", capture)
    assert "masks: expected mattes with the object in white, got only black ones" in output
