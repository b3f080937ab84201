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
from tests.matting.captures import unmasked


def contents(capture: Path) -> dict[str, bytes]:
    return {str(path.relative_to(capture)): path.read_bytes() for path in sorted(capture.glob(".fourd/mattes/*/*"))}


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
    capture = unmasked(tmp_path, frames=2, size=32)
    assert main(["matte", str(capture), *options]) == 2
    told = capsys.readouterr().err
    assert message in told
    assert told.count("\n") == 1


def test_masks_that_are_there_are_used(ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Catches mattes made over masks that the user brought, and plates that are left out then."""
    capture = tmp_path / "capture"
    shutil.copytree(ball_capture, capture)
    assert main(["matte", str(capture), "--workers", "1"]) == 0
    assert "found mattes there; none made" in capsys.readouterr().out
    assert not (capture / ".fourd" / "mattes").exists()
    assert len(list((capture / ".fourd" / "plates").glob("*.png"))) == 8


@pytest.mark.slow
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_stopped_command_goes_on_to_the_same_mattes(how: signal.Signals, tmp_path: Path) -> None:
    """Catches files cut in half, work that begins anew, and mattes that depend on where it was stopped."""
    whole = unmasked(tmp_path / "whole", frames=8, size=64)
    stopped = tmp_path / "stopped"
    shutil.copytree(whole, stopped, copy_function=shutil.copy2)
    command = [sys.executable, "-m", "fourd.cli.main", "matte", "--no-plates", "--workers", "1"]
    subprocess.run([*command, str(whole)], check=True, timeout=300)
    process = subprocess.Popen([*command, str(stopped)], stderr=subprocess.PIPE)
    first = stopped / ".fourd" / "mattes" / "07" / "000001.png"
    deadline = time.monotonic() + 200
    while not first.exists():
        assert process.poll() is None, "ended before it could be stopped"
        assert time.monotonic() < deadline
        time.sleep(0.002)
    process.send_signal(how)
    code = process.wait(60)
    assert code == (130 if how == signal.SIGINT else -signal.SIGKILL)
    before = first.stat().st_mtime_ns
    assert len(contents(stopped)) < len(contents(whole))
    subprocess.run([*command, str(stopped)], check=True, timeout=300)
    assert contents(stopped) == contents(whole)
    assert first.stat().st_mtime_ns == before, "what was finished is not made again"
