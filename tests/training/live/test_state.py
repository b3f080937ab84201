"""The state of a training that other processes read."""

from __future__ import annotations

import json
import os
import platform
import signal
import subprocess
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from fourd.base.errors import UserError
from fourd.reconstruction.training.live.session import LiveSession, StepCount
from fourd.reconstruction.training.live.state import TrainingState, is_training, read_state, write_state
from tests.training.small import quiet

STATE = TrainingState("0123456789abcdef", platform.node(), "training", 10, 2.5, 0.25, 40, True, 1e9)


def session(run: Path) -> LiveSession:
    return LiveSession(run, 40, False, quiet())


@pytest.mark.parametrize(
    ("error", "phase", "reason"),
    [
        (None, "finished", ""),
        (KeyboardInterrupt(), "stopped", ""),
        (UserError("run: expected free\x1b[31m disk space, got none"), "failed", "run: expected free\\x1b[31m disk"),
        (ValueError("secret"), "failed", "ValueError"),
    ],
)
def test_the_end_of_a_training(error: BaseException | None, phase: str, reason: str, tmp_path: Path) -> None:
    """Catches a state that stays `training` after an error, and control characters of the error in the state."""
    try:
        with session(tmp_path) as live:
            live.show(StepCount(4, 1.0, 0.1))
            during = read_state(tmp_path)
            assert during is not None
            assert is_training(tmp_path, during)
            live.show(StepCount(7, 1.5, 0.2))
            if error is not None:
                raise error
    except BaseException as caught:
        if caught is not error:
            raise
    state = read_state(tmp_path)
    assert state is not None
    assert (state.phase, state.step, state.spent, state.is_held_out) == (phase, 7, 0.2, False)
    assert state.reason.startswith(reason)
    assert not is_training(tmp_path, state)


def test_the_state_of_a_killed_training(tmp_path: Path) -> None:
    """Catches a run whose state remains `training` after its process was killed."""
    program = (
        "import sys, time, pathlib\n"
        "from rich.console import Console\n"
        "from fourd.reconstruction.training.live.session import LiveSession, StepCount\n"
        "with LiveSession(pathlib.Path(sys.argv[1]), 40, True, Console()) as live:\n"
        "    live.show(StepCount(3, 1.0, 0.1))\n"
        "    print('ready', flush=True)\n"
        "    time.sleep(60)\n"
    )
    process = subprocess.Popen([sys.executable, "-c", program, str(tmp_path)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    state = read_state(tmp_path)
    assert state is not None
    assert is_training(tmp_path, state)
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    assert not is_training(tmp_path, state)
    with session(tmp_path) as live:
        live.show(StepCount(3, 1.0, 0.1))
        state = read_state(tmp_path)
        assert state is not None
        assert is_training(tmp_path, state)


@pytest.mark.parametrize("host", [STATE.host, "another"])
def test_without_locks_the_age_decides(host: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a wrong answer to whether a run trains, on systems without locks and on other machines."""
    if host == STATE.host:
        monkeypatch.setattr("fourd.reconstruction.training.live.state._is_locked", lambda folder: None)
    state = replace(STATE, host=host, updated=time.time())
    assert is_training(tmp_path, state)
    assert not is_training(tmp_path, replace(state, updated=time.time() - 1000))
    assert not is_training(tmp_path, replace(state, phase="finished"))


@pytest.mark.parametrize(
    "change",
    [
        {"phase": "sleeping"},
        {"step": -1},
        {"step": 1.5},
        {"step": True},
        {"spent": 1.5},
        {"seconds": "1"},
        {"updated": float("nan")},
        {"max_steps": "9"},
        {"is_held_out": 1},
        {"reason": "x" * 501},
        {"session": None},
        {"more": 1},
    ],
)
def test_damaged_states_are_no_states(change: dict[str, object], tmp_path: Path) -> None:
    """Catches values of wrong types and sizes that reach the pages."""
    (tmp_path / "live").mkdir()
    write_state(tmp_path, STATE)
    assert read_state(tmp_path) == STATE
    (tmp_path / "live" / "state.json").write_text(json.dumps({**asdict(STATE), **change}))
    assert read_state(tmp_path) is None


def test_files_that_are_no_states(tmp_path: Path) -> None:
    """Catches a server that fails or waits if the state file is a folder, a link or a named pipe."""
    path = tmp_path / "live" / "state.json"
    assert read_state(tmp_path) is None
    path.parent.mkdir()
    for content in (b"", b"{", b"\xff\xfe", b"[" * 9000, b" " * 100_000):
        path.write_bytes(content)
        assert read_state(tmp_path) is None
    path.unlink()
    os.mkfifo(path)
    assert read_state(tmp_path) is None


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    """Catches a training that ends because its state cannot be written."""
    (tmp_path / "live").write_text("a file")
    with session(tmp_path) as live:
        live.show(StepCount(1, 1.0, 0.1))
        live.look()
    assert live.wanted is None
