"""The command ``fourd import``: one-line errors with exit code 2, and log lines."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from fourd.cli.main import main
from fourd.recording.calibration.image_sizes import size_hypotheses
from fourd.recording.calibration.principal_points import principal_point_hypotheses
from fourd.recording.capture import open_capture, read_calibration, write_calibration
from tests.calibration.rooms import Room, room_cameras
from tests.importing.test_importer import write_source

BALANCE = Path(__file__).parents[2].parent / "shared" / "captures" / "balance"


def refused_line(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """The single error line of an import."""
    assert main(["import", *map(str, words)]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("fourd import: ")]
    assert len(lines) == 1
    return lines[0]


def imported_log(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """All log lines of a successful import."""
    assert main(["import", *map(str, words)]) == 0
    output = capsys.readouterr()
    assert "next: fourd check" in output.out
    return output.err


def test_arguments_are_checked(ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a mistyped format name that is used as a path, and a missing source without an error."""
    out = tmp_path / "out"
    assert "got 'easymocab'; did you mean 'easymocap'?" in refused_line(capsys, "easymocab", ball_capture, out)
    assert "got a path that does not exist; check the path" in refused_line(capsys, tmp_path / "gone", out)
    assert "expected [FORMAT] SRC OUT, got 1 arguments" in refused_line(capsys, ball_capture)
    (tmp_path / "empty").mkdir()
    line = refused_line(capsys, tmp_path / "empty", out)
    assert "got none of these" in line
    assert "(qualisys)" in line
    assert not out.exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--offset", "d=3"), "--offset: expected a camera among a, b, c, got 'd'"),
        (("--offset", "a"), "--offset: expected CAM=FRAMES, each camera once, got 'a'"),
        (("--offset", "a=1,a=2"), "each camera once, got 'a=2'"),
        (("--offset", "a=x"), "got 'a=x'"),
        (("--scale", "a,b"), "--scale: expected CAM,CAM=METRES, got 'a,b'"),
        (("--scale", "a,b=nan"), "got 'a,b=nan'"),
        (("--scale", "a,z=2"), "--scale: expected two cameras among a, b, c, got 'z'"),
        (("--board", "9x6"), "--board: expected COLSxROWSxSQUARE_M, got '9x6'"),
        (("--board", "9x6x-1"), "got '9x6x-1'"),
        (
            ("--board", "9x6x25"),
            "--board 9x6x25: expected the side of a square in metres, got 25",
        ),
        (("--sync", "--apply-sync"), "choose one"),
    ],
)
def test_options_are_checked(
    words: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches an option that is misread, or that is checked only after minutes of work."""
    source = write_source(tmp_path / "source")
    assert message in refused_line(capsys, source, tmp_path / "out", *words)
    assert not (tmp_path / "out").exists()


def test_offsets_of_pictures_are_refused(
    ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches an offset that is silently ignored."""
    assert "got images" in refused_line(capsys, ball_capture, tmp_path / "out", "--offset", "02=1")


def test_other_captures_are_not_overwritten(
    ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches an import that overwrites the calibration in a mistyped output folder."""
    source = write_source(tmp_path / "source")
    before = (ball_capture / "intri.yml").read_bytes()
    assert "got a folder with other files; name another" in refused_line(capsys, source, ball_capture)
    assert "expected an output that is not an input" in refused_line(capsys, source, source)
    assert (ball_capture / "intri.yml").read_bytes() == before


def test_uncalibrated_cameras_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches an import that succeeds although some cameras are unusable."""
    source = write_source(tmp_path / "source")
    calibrations = read_calibration(source)
    write_calibration(source, ["a", "b"], [calibrations[name].camera(32, 48) for name in ("a", "b")])
    line = refused_line(capsys, source, tmp_path / "out")
    assert "expected a calibration of every camera, got none for c; add the missing calibrations" in line
    assert "--calibrate" in line


def write_room(folder: Path, names: list[str], true: list, calibration: list) -> Path:  # type: ignore[type-arg]
    room = Room(np.random.default_rng(4))
    write_calibration(folder, names, calibration)
    for name, camera in zip(names, true, strict=True):
        path = folder / "images" / name / "000000.png"
        path.parent.mkdir(parents=True)
        cv2.imwrite(str(path), cv2.cvtColor(room.picture(camera), cv2.COLOR_RGB2BGR))
    return folder


def test_unclear_sizes_ask_for_resize(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches an import that chooses one of several equally likely resizing methods instead of reporting an error."""
    source = write_source(tmp_path / "source")
    cameras = [replace(of.camera(32, 48), width=36) for of in read_calibration(source).values()]
    write_calibration(source, ["a", "b", "c"], cameras)
    line = refused_line(capsys, source, tmp_path / "out")
    assert "a, b, c: expected images of the calibration's size, or images that show clearly" in line
    assert "got 36 x 48 -> 32 x 48 (" in line
    assert "stretched: no matches" in line
    assert "fourd import --resize NAME" in line
    assert not (tmp_path / "out" / "intri.yml").exists()
    assert "expected one of" in refused_line(capsys, source, tmp_path / "out", "--resize", "squeezed")
    assert "cropped left (given by --resize)" in imported_log(
        capsys, source, tmp_path / "out", "--resize", "cropped left"
    )
    assert np.allclose(open_capture(tmp_path / "out").cameras[0].intrinsics[0, 2], cameras[0].intrinsics[0, 2] - 4)


def test_stretched_pictures_and_mirrored_centres_are_found(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches image sizes and principal points that are tested separately. Also catches a fix without --centres, and a
    missing fix with --centres."""
    names = ["a", "b", "c", "d"]
    shift = np.array([[0, 0, 14.0], [0, 0, -9.0], [0, 0, 0]])
    given = [replace(camera, intrinsics=camera.intrinsics + shift) for camera in room_cameras(4, 256, 192)]
    true = [size_hypotheses(camera, 256, 160)["stretched"] if i < 2 else camera for i, camera in enumerate(given)]
    mirrored = [
        principal_point_hypotheses(camera)[what]
        for camera, what in zip(given, ("mirrored x", "mirrored both", "mirrored y", "mirrored x"), strict=True)
    ]
    source = write_room(tmp_path / "source", names, true, mirrored)
    output = imported_log(capsys, source, tmp_path / "out")
    assert "a, b: 256 x 192 -> 256 x 160: stretched" in output
    assert "warning: principal points look mirrored: a x, b both, c y, d x" in output
    assert "--centres mirrored" in output
    before = open_capture(tmp_path / "out").cameras
    assert np.allclose(before[2].intrinsics, mirrored[2].intrinsics)
    assert "principal points mirrored: a x, b both, c y, d x" in imported_log(
        capsys, source, tmp_path / "out", "--centres", "mirrored"
    )
    for written, camera in zip(open_capture(tmp_path / "out").cameras, true, strict=True):
        assert np.allclose(written.intrinsics, camera.intrinsics, atol=1e-6)


def test_good_calibration_is_unchanged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a correct calibration that is reported as mirrored, and a scale that is not applied."""
    cameras = room_cameras(4, 256, 192)
    source = write_room(tmp_path / "source", ["a", "b", "c", "d"], cameras, cameras)
    output = imported_log(capsys, "easymocap", source, tmp_path / "out", "--scale", "a,b=3")
    assert "easymocap: " in output
    assert "warning" not in output
    assert "matches within 3 px of their epipolar lines" in output
    centres = [camera.centre for camera in open_capture(tmp_path / "out").cameras]
    assert np.isclose(np.linalg.norm(centres[0] - centres[1]), 3)


def test_check_reports_residuals_and_names_the_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a displaced camera that is not reported, correct cameras that are reported, and slow checks that run in
    spite of --quick.
    """
    true = room_cameras(5, 320, 240)
    angle = np.deg2rad(2.5)
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    displaced = [replace(c, rotation=turn @ c.rotation, translation=turn @ c.translation) if i == 3 else c
               for i, c in enumerate(true)]  # fmt: skip
    source = write_room(tmp_path / "source", list("abcde"), true, displaced)
    assert main(["check", str(source)]) == 0
    output = capsys.readouterr().out
    assert "matches within 3 px" in output
    assert "extri.yml: camera 'd' disagrees with the others by" in output
    assert output.count("disagrees with the others") == 1
    write_calibration(source, list("abcde"), true)
    assert main(["check", str(source)]) == 0
    assert "disagree" not in capsys.readouterr().out
    assert main(["check", str(source), "--quick"]) == 0
    assert "epipolar" not in capsys.readouterr().out


@pytest.mark.slow
def test_real_recording_is_corrected(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a real capture whose letterboxed images or mirrored principal points are not recognised."""
    if not BALANCE.is_dir():
        pytest.skip(f"no real capture at {BALANCE}")
    output = imported_log(capsys, BALANCE, tmp_path / "out")
    assert "qualisys: NAME.qca.txt and one video per camera" in output
    assert "cam01, cam02: 1088 x 1920 -> 1080 x 1920: letterboxed (black bars of 7.0" in output
    assert "warning: principal points look mirrored: cam01 x, cam02 y, cam03 y, cam04 y" in output
    output = imported_log(capsys, BALANCE, tmp_path / "out", "--centres", "mirrored")
    assert "principal points mirrored: cam01 x, cam02 y, cam03 y, cam04 y" in output


@pytest.mark.slow
@pytest.mark.parametrize(
    "when", [".fourd/import.json", ".fourd/videos.json", "images/a/000003.jpg", "images/c/000020.jpg"]
)
def test_killed_import_resumes_to_the_same_capture(when: str, tmp_path: Path) -> None:
    """Catches truncated or rewritten images, and a folder that later imports refuse."""
    source = write_source(tmp_path / "source")
    command = [sys.executable, "-m", "fourd.cli.main", "import", "--unpack", str(source)]
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    subprocess.run([*command, str(whole)], check=True, timeout=100)
    process = subprocess.Popen([*command, str(stopped)])
    deadline = time.monotonic() + 100
    while not (stopped / when).exists():
        assert process.poll() is None, "the import ended too early"
        assert time.monotonic() < deadline
        time.sleep(0.001)
    process.kill()
    assert process.wait(60) == -signal.SIGKILL
    before = {path: path.stat().st_mtime_ns for path in stopped.glob("images/*/[!.]*")}
    assert len(before) < 3 * 40
    subprocess.run([*command, str(stopped)], check=True, timeout=100)
    assert contents(stopped) == contents(whole)
    assert {path: path.stat().st_mtime_ns for path in before} == before, "finished files are written again"


def contents(capture: Path) -> dict[str, bytes]:
    return {str(path.relative_to(capture)): path.read_bytes() for path in sorted(capture.rglob("*")) if path.is_file()}
