"""``fourd matte`` from outside: what it says, and what a kill leaves."""

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
    """All that was made, by name."""
    paths = sorted(path for path in (capture / ".fourd").rglob("*") if path.is_file())
    return {str(path.relative_to(capture)): path.read_bytes() for path in paths}


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--method", "chroma", "--screen", "green"), "--screen: expected R,G,B"),
        (("--method", "chroma"), "expected a screen of one colour"),
        (("--method", "rvm"), "--rvm: expected the file of the network for --method rvm, got none; name it"),
        (("--workers", "0"), "--workers: expected at least 1, got 0"),
        (("--views", "nobody"), "--views: expected camera names among"),
    ],
)
def test_wrong_options_are_one_line(
    options: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches tracebacks, and work begun before an option is looked at."""
    capture = write_capture_without_masks(tmp_path, frames=2, size=32)
    assert main(["matte", str(capture), *options]) == 2
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1


def test_masks_that_are_there_are_used(ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches mattes made over masks that the user brought, and plates that are left out then."""
    capture = tmp_path / "capture"
    shutil.copytree(ball_capture, capture)
    assert main(["matte", str(capture), "--workers", "1"]) == 0
    assert "the capture has masks; no mattes made" in capsys.readouterr().out
    assert not (capture / ".fourd" / "mattes").exists()
    assert len(list((capture / ".fourd" / "plates").glob("*.png"))) == 8


def stopped_when(there: Path, how: signal.Signals, command: list[str]) -> int:
    """The exit code of a command that is stopped as soon as a file is there."""
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler)
    )
    deadline = time.monotonic() + 200
    while not there.exists():
        assert process.poll() is None, "ended before it could be stopped"
        assert time.monotonic() < deadline
        time.sleep(0.002)
    process.send_signal(how)
    told = process.communicate(timeout=60)[1]  # returns when its children have ended too
    assert b"Traceback" not in told
    return process.returncode


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture of which ``fourd matte`` made everything undisturbed. Not to be changed by tests."""
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
def test_a_stopped_command_goes_on_to_the_same_files(
    how: signal.Signals, workers: str, when: str, finished: Path, tmp_path: Path
) -> None:
    """Catches files cut in half, work that begins anew, and files that depend on where and how it was stopped."""
    stopped = tmp_path / "stopped"
    shutil.copytree(finished, stopped, copy_function=shutil.copy2, ignore=shutil.ignore_patterns(".fourd"))
    command = [*MATTE, workers, str(stopped)]
    code = stopped_when(stopped / ".fourd" / when, how, command)
    assert code in ((130, -signal.SIGINT) if how == signal.SIGINT else (-signal.SIGKILL,))
    made = stopped.glob(".fourd/[mps]*/**/[!.]*.png")
    before = {path: path.stat().st_mtime_ns for path in [*made, *stopped.glob(".fourd/subject.npz")]}
    assert len(contents(stopped)) < len(contents(finished))
    subprocess.run(command, check=True, timeout=300)
    assert contents(stopped) == contents(finished)
    again = [path.name for path, time_ns in before.items() if path.stat().st_mtime_ns != time_ns]
    assert not again, "what was finished is made again"
