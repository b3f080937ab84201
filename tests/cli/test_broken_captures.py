"""Tests that ``fourd check`` and ``fourd make`` report the errors of a broken capture. The captures are synthetic."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.cli.main import main
from fourd.recording.capture import read_calibration, write_calibration
from fourd.recording.synth import generate
from fourd.recording.synth.folder import write_cameras
from fourd.recording.synth.generate import make_synthetic

NAMES = ("00", "01", "02", "03", "04", "05")
SIZE = 384
Break = Callable[[Path], None]


@pytest.fixture(scope="module")
def synthetic(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six neighbouring cameras of a ring of 24, 15 degrees apart, so that features match."""
    folder = tmp_path_factory.mktemp("synthetic") / "capture"

    def write_some(names: list[str], frames: int, write: Callable[[int, Callable[[], None]], None]) -> None:
        write_cameras(names[: len(NAMES)], frames, write)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(generate, "write_cameras", write_some)
        make_synthetic(folder, frames=2, cameras=24, size=SIZE)
    calibrations = read_calibration(folder)
    write_calibration(folder, NAMES, [calibrations[name].camera(SIZE, SIZE) for name in NAMES])
    return folder


def change_calibration(folder: Path, order: tuple[str, ...]) -> None:
    """Give the cameras NAMES the calibrations of the cameras ``order``."""
    calibrations = read_calibration(folder)
    write_calibration(folder, NAMES, [calibrations[name].camera(SIZE, SIZE) for name in order])


def exchange(folder: Path) -> None:
    change_calibration(folder, ("00", "04", "02", "03", "01", "05"))


def turn_upside_down(folder: Path) -> None:
    for kind in ("images", "masks"):
        for path in (folder / kind / "03").iterdir():
            picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            cv2.imwrite(str(path), cv2.rotate(picture, cv2.ROTATE_180))


def use_another_rig(folder: Path) -> None:
    change_calibration(folder, ("03", "05", "00", "04", "02", "01"))


def rename_calibration(folder: Path) -> None:
    calibrations = read_calibration(folder)
    cameras = [calibrations[name].camera(SIZE, SIZE) for name in NAMES]
    write_calibration(folder, [f"left{name}" for name in NAMES], cameras)


def use_other_mattes(folder: Path) -> None:
    other = folder.parent / "other"
    make_synthetic(other, frames=2, cameras=6, size=SIZE, seed=7)
    shutil.rmtree(folder / "masks")
    shutil.copytree(other / "masks", folder / "masks")


def checked(capture: Path, capsys: pytest.CaptureFixture[str]) -> str:
    main(["check", str(capture)])
    output = capsys.readouterr()
    return " ".join((output.out + output.err).split())


def made(capture: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """Return the output of ``fourd make``. The command fails, or trains for one step."""
    main(["make", str(capture), "-o", str(capture.parent / "scene.4dv"), "--max-steps", "1", "--points", "200"])
    output = capsys.readouterr()
    return " ".join((output.out + output.err).split())


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (exchange, "cameras '01' and '04': their calibrations look exchanged (median "),
        (turn_upside_down, "camera '03': its images look upside down (median "),
        (rename_calibration, "expected camera '00', since images/00 exists, got no such name"),
    ],
)
def test_broken_captures_stop_with_a_message(
    synthetic: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: Break, message: str
) -> None:
    """Catches mistakes that are reported only as a large residual, or only after half an hour of training. The mistakes
    are exchanged calibrations, a view that is upside down, and a calibration of other cameras."""
    capture = Path(shutil.copytree(synthetic, tmp_path / "capture"))
    damage(capture)
    assert message in checked(capture, capsys)
    assert f"fourd make: {capture}" in (output := made(capture, capsys))
    assert message in output
    assert "train: running" not in output


WARNINGS = (
    (use_another_rig, "the calibration may belong to other cameras or another recording"),
    (use_other_mattes, "the mattes of all cameras do not follow the contours in the images; they may belong to"),
)


@pytest.mark.parametrize(("damage", "message"), WARNINGS)
def test_broken_captures_are_reported(
    synthetic: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: Break, message: str
) -> None:
    """Catches a calibration of another rig and mattes of another recording that are not reported."""
    capture = Path(shutil.copytree(synthetic, tmp_path / "capture"))
    damage(capture)
    assert message in checked(capture, capsys)


@pytest.mark.slow
@pytest.mark.parametrize(("damage", "message"), WARNINGS)
def test_make_warns_of_broken_captures(
    synthetic: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], damage: Break, message: str
) -> None:
    """Catches training on a broken capture without a message."""
    capture = Path(shutil.copytree(synthetic, tmp_path / "capture"))
    damage(capture)
    output = made(capture, capsys)
    assert f"warning: {capture}" in output
    assert message in output


def test_whole_captures_have_no_warning(synthetic: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches warnings about a correct capture."""
    output = checked(synthetic, capsys)
    assert "warning" not in output
    assert "matches within 3 px" in output


@pytest.mark.slow
def test_exchanged_cameras_of_a_large_ring_are_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches cameras that are not checked because they match none of their neighbours. Cameras with exchanged
    calibrations are compared with the wrong neighbours."""
    capture = tmp_path / "capture"
    make_synthetic(capture, frames=1, cameras=24, size=SIZE)
    names = [f"{index:02d}" for index in range(24)]
    calibrations = read_calibration(capture)
    order = [*names[:3], "14", *names[4:14], "03", *names[15:]]
    write_calibration(capture, names, [calibrations[name].camera(SIZE, SIZE) for name in order])
    assert "cameras '03' and '14': their calibrations look exchanged" in checked(capture, capsys)


def test_a_late_camera_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a camera that started two seconds late and is not reported."""
    source, capture = tmp_path / "source", tmp_path / "capture"
    make_synthetic(source, frames=16, cameras=5, size=96)
    rng = np.random.default_rng(3)
    # The figure's motion is periodic, so it is played at an uneven speed.
    played = np.cumsum(np.repeat(rng.integers(0, 4, 60), 2)) % 16
    late = 20
    for name in ("00", "01", "02", "03", "04"):
        for kind in ("images", "masks"):
            files = sorted((source / kind / name).iterdir())
            folder = capture / kind / name
            folder.mkdir(parents=True)
            for frame in range(90):
                path = files[played[frame + late - (late if name == "03" else 0)]]
                os.link(path, folder / f"{frame:06d}{path.suffix}")
    for file in ("intri.yml", "extri.yml"):
        shutil.copy(source / file, capture / file)
    output = checked(capture, capsys)
    assert "camera '03' is late by 20 frames compared with the motion in the other cameras (confidence " in output
    assert "--offset 03=20" in output
    assert output.count("compared with the motion") == 1
