"""Requests to a training with two ranks, each of which is a process on this machine."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from fourd.reconstruction.training.live.control import Action, ControlRequest, write_request
from fourd.reconstruction.training.live.state import TrainingState, read_state
from fourd.reconstruction.training.run import load_run
from tests.training.distributed.test_ranks import OVERLAY, start_ranks


@pytest.mark.slow
def test_ranks_pause_and_stop_together(ball_capture: Path, tmp_path: Path) -> None:
    """Catches ranks that wait for each other without end, because only one of them pauses or stops."""
    (tmp_path / "small.yaml").write_text(OVERLAY)
    run = tmp_path / "run"
    words = ["fourd.cli.main", "train", str(ball_capture), "-o", str(run), "--config", str(tmp_path / "small.yaml")]
    results = []

    def train() -> None:
        results.extend(start_ranks([[*words, "--max-steps", "100000"]] * 2))

    def wait_for(condition: Callable[[TrainingState], bool]) -> TrainingState:
        deadline = time.monotonic() + 120
        while time.monotonic() < deadline:
            state = read_state(run)
            if state is not None and condition(state):
                return state
            time.sleep(0.05)
        raise AssertionError(f"the ranks do not answer: {read_state(run)}")

    def request(action: Action) -> None:
        write_request(run, ControlRequest(session, action))

    thread = threading.Thread(target=train)
    thread.start()
    session = wait_for(lambda state: state.step > 0).session
    request("pause")
    paused = wait_for(lambda state: state.phase == "paused")
    time.sleep(2)
    assert wait_for(lambda state: True).step == paused.step
    request("resume")
    wait_for(lambda state: state.phase == "training" and state.step > paused.step)
    request("stop")
    stopped = wait_for(lambda state: state.phase == "stopped")
    thread.join()
    assert [result.returncode for result in results] == [130, 130], results
    trained = load_run(run)
    trained.close()
    assert trained.step == stopped.step
