"""Locks on folders, and Ctrl-C between two steps."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from fourd.base.errors import UserError
from fourd.base.processes import DeferredInterrupt, locked_folder
from fourd.cli.main import main
from tests.baking.scenes import write_scene

HOLDER = """
import sys
from pathlib import Path
from fourd.base.processes import locked_folder
with locked_folder(Path(sys.argv[1])):
    print("locked", flush=True)
    sys.stdin.read()
"""


def hold(folder: Path) -> subprocess.Popen[str]:
    """Start a process that locks the folder. The process releases the lock when its standard input is closed."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "locked\n"
    return process


def test_a_second_process_is_refused_until_the_first_is_killed(tmp_path: Path) -> None:
    """Catches two commands that delete each other's files, and a killed command that blocks all later commands."""
    with hold(tmp_path / "run") as process:
        with (
            pytest.raises(UserError, match="run: expected a folder that no other command changes, got") as error,
            locked_folder(tmp_path / "run"),
        ):
            pass
        if Path("/proc/locks").exists() and f" {process.pid} " in Path("/proc/locks").read_text():
            assert re.search(rf"process {process.pid} \(.*\), which started at \d{{4}}-", str(error.value))
        process.send_signal(signal.SIGKILL)
        process.wait()
    with locked_folder(tmp_path / "run"):
        assert (tmp_path / "run").is_dir()


def test_an_unused_new_folder_is_removed(tmp_path: Path) -> None:
    """Catches a failed command that leaves an empty folder, and a lock that deletes results or the user's folder."""
    with locked_folder(tmp_path / "a" / "new"):
        pass
    assert not (tmp_path / "a" / "new").exists()
    with locked_folder(tmp_path / "kept"):
        (tmp_path / "kept" / "result").touch()
    assert (tmp_path / "kept" / "result").exists()
    with locked_folder(tmp_path):
        pass
    assert tmp_path.exists()
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match="file: expected a folder, got a file"), locked_folder(tmp_path / "file"):
        pass


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_first_interrupt_is_deferred_and_the_second_is_not(number: signal.Signals) -> None:
    """Catches Ctrl-C that takes effect in the middle of an optimizer step, and a program that Ctrl-C does not end."""
    before = signal.getsignal(number)
    try:
        signal.signal(number, signal.default_int_handler)
        with DeferredInterrupt() as interrupt:
            assert not interrupt.is_pending
            os.kill(os.getpid(), number)
            assert interrupt.is_pending
            with pytest.raises(KeyboardInterrupt):
                os.kill(os.getpid(), number)
        assert signal.getsignal(number) is signal.default_int_handler
    finally:
        signal.signal(number, before)


def test_commands_refuse_a_folder_that_is_in_use(
    ball_capture: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a command without a lock, and a lock that is not released."""
    capture = shutil.copytree(ball_capture, tmp_path / "capture")
    out, scene, board = tmp_path / "out", tmp_path / "scene.4dv", tmp_path / "board.toml"
    write_scene(scene, points=5)
    board.write_text("columns = 5\nrows = 4\nsquare_m = 0.03\n")
    commands = {
        ("train", capture, "-o", out, "--max-steps", "1"): out,
        ("make", capture, "-o", tmp_path / "scene.4dv"): tmp_path / "scene.work",
        ("matte", capture): capture / ".fourd",
        ("import", "easymocap", capture, out): out,
        ("carve", capture, "--out", out): out,
        ("mesh", capture, "-o", out): out,
        ("synth", out): out,
        ("web", scene, "-o", out): out,
        ("calibrate", capture, "--board", board, "-o", out): out,
    }
    for words, folder in commands.items():
        with locked_folder(folder):
            assert main([str(word) for word in words]) == 2
        lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith(f"fourd {words[0]}: ")]
        assert len(lines) == 1
        assert f"{folder}: expected a folder that no other command changes" in lines[0]
        assert not folder.exists()
