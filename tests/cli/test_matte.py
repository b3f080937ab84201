"""Tests of ``fourd matte``: its errors, and its files after an interruption."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fourd.cli.main import main
from tests.matting.captures import write_capture_without_masks

MATTE = (sys.executable, "-m", "fourd.cli.main", "matte", "--workers")


def contents(capture: Path) -> dict[str, bytes]:
    """All files below .fourd, by name."""
    paths = sorted(path for path in (capture / ".fourd").rglob("*") if path.is_file())
    return {str(path.relative_to(capture)): path.read_bytes() for path in paths}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--method", "chroma", "--screen", "green"), "--screen: expected R,G,B"),
        (("--method", "chroma"), "expected a screen of one colour"),
        (("--method", "rvm"), "--rvm: expected a network file for --method rvm, got none; pass --rvm FILE"),
        (("--workers", "0"), "--workers: expected at least 1, got 0"),
        (("--views", "nobody"), "--views: expected camera names among"),
        (("--test-views", "nobody"), "--test-views: expected camera names among"),
    ],
)
def test_wrong_options_are_one_line(
    options: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches tracebacks, and work that starts before an option is checked."""
    capture = write_capture_without_masks(tmp_path, frames=2, size=32)
    assert main(["matte", str(capture), *options]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_masks_of_the_capture_are_used(ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a capture with masks for which mattes are made, or for which no clean plates are made."""
    capture = tmp_path / "capture"
    shutil.copytree(ball_capture, capture)
    assert main(["matte", str(capture), "--workers", "1"]) == 0
    assert "the capture has masks, so no mattes were made" in capsys.readouterr().out
    assert not (capture / ".fourd" / "mattes").exists()
    assert len(list((capture / ".fourd" / "plates").glob("*.png"))) == 8
    assert main(["matte", str(capture), "--test-views", "nobody"]) == 2
    assert "--test-views: expected camera names among" in capsys.readouterr().err


def test_a_folder_without_cameras_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches a traceback when a camera of an empty folder is named: no name is similar to it."""
    assert main(["matte", str(tmp_path), "--test-views", "03"]) == 2
    assert "--test-views: expected a capture with cameras, got one without" in capsys.readouterr().err


def stop_when_exists(path: Path, how: signal.Signals, command: list[str]) -> int:
    """The exit code of a command that gets a signal as soon as ``path`` exists."""
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler)
    )
    deadline = time.monotonic() + 200
    while not path.exists():
        assert process.poll() is None, "ended before it could be stopped"
        assert time.monotonic() < deadline
        time.sleep(0.002)
    process.send_signal(how)
    error = process.communicate(timeout=60)[1]  # returns after all child processes have ended
    assert b"Traceback" not in error
    return process.returncode


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture on which ``fourd matte`` ran without interruption. Tests must not change this capture."""
    capture = write_capture_without_masks(tmp_path_factory.mktemp("finished"), frames=8, size=64)
    subprocess.run([*MATTE, "1", str(capture)], check=True, timeout=300)
    return capture


@pytest.mark.slow
@pytest.mark.parametrize(
    ("how", "workers", "when"),
    [
        (signal.SIGKILL, "1", "mattes.json"),
        (signal.SIGINT, "1", "mattes/07/000001.png"),
        (signal.SIGKILL, "2", "subject.npz"),
        (signal.SIGKILL, "2", "mattes/07/000001.png"),
        (signal.SIGINT, "2", "mattes/07/000001.png"),
        (signal.SIGKILL, "2", "mattes.png"),
        (signal.SIGINT, "1", "plates.json"),
    ],
)
def test_stopped_commands_resume_to_the_same_files(
    how: signal.Signals, workers: str, when: str, finished: Path, tmp_path: Path
) -> None:
    """Catches truncated files, finished work that is repeated, and files that depend on when and how the command was
    stopped.
    """
    stopped = tmp_path / "stopped"
    shutil.copytree(finished, stopped, copy_function=shutil.copy2, ignore=shutil.ignore_patterns(".fourd"))
    command = [*MATTE, workers, str(stopped)]
    code = stop_when_exists(stopped / ".fourd" / when, how, command)
    assert code in ((130, -signal.SIGINT) if how == signal.SIGINT else (-signal.SIGKILL,))
    made = stopped.glob(".fourd/[mps]*/**/[!.]*.png")
    before = {path: path.stat().st_mtime_ns for path in [*made, *stopped.glob(".fourd/subject.npz")]}
    assert len(contents(stopped)) < len(contents(finished))
    subprocess.run(command, check=True, timeout=300)
    assert contents(stopped) == contents(finished)
    again = [path.name for path, time_ns in before.items() if path.stat().st_mtime_ns != time_ns]
    assert not again, "finished files are made again"
