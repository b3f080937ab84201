"""Requests to a training to pause, resume, save and stop, and requests that a training must ignore."""

from __future__ import annotations

import io
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from rich.console import Console

from fourd.pipeline.make import create_run
from fourd.reconstruction.training.live.control import Action, ControlReader, ControlRequest, write_request
from fourd.reconstruction.training.live.state import TrainingState, is_training, read_state
from fourd.reconstruction.training.loop import Trainer
from fourd.reconstruction.training.run import open_run
from tests.training.small import SMALL, quiet, train
from tests.training.test_loop import checkpoint_tensors

CONFIG = replace(SMALL, max_steps=9, checkpoint_steps=100)


@pytest.fixture(autouse=True)
def short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make the training look for requests after each step."""
    monkeypatch.setattr("fourd.reconstruction.training.live.session.CONTROL_SECONDS", 0.0)
    monkeypatch.setattr("fourd.reconstruction.training.live.session.STATE_SECONDS", 0.0)
    monkeypatch.setattr("fourd.reconstruction.training.loop.CONTROL_SECONDS", 0.01)


def state_of(run: Path) -> TrainingState:
    state = read_state(run)
    assert state is not None
    return state


def request(run: Path, action: Action) -> None:
    write_request(run, ControlRequest(state_of(run).session, action))


def train_with(folder: Path, at_step: int, act: Callable[[], None], console: Console | None = None) -> None:
    """Train a run. ``act`` is called before the step ``at_step``."""
    trainer = Trainer(open_run(folder), None, console or quiet(), CONFIG)
    original = trainer._step

    def step(log: object) -> None:
        if trainer.done == at_step:
            act()
        original(log)  # type: ignore[arg-type]

    trainer._step = step  # type: ignore[method-assign]
    trainer.train()


@contextmanager
def when_paused(run: Path, act: Callable[[TrainingState], None]) -> Iterator[None]:
    """Call ``act`` in another thread as soon as the run is paused."""

    def wait() -> None:
        deadline = time.monotonic() + 60
        while time.monotonic() < deadline:
            state = read_state(run)
            if state is not None and state.phase == "paused":
                act(state)
                return
            time.sleep(0.005)

    thread = threading.Thread(target=wait)
    thread.start()
    yield
    thread.join()


@pytest.fixture(scope="module")
def unbroken(ball_capture: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, torch.Tensor]:
    """The last checkpoint of a run without requests."""
    folder = tmp_path_factory.mktemp("unbroken") / "run"
    train(create_run(ball_capture, folder, CONFIG), CONFIG)
    return checkpoint_tensors(folder, 9)


def assert_same(run: Path, expected: dict[str, torch.Tensor]) -> None:
    got = checkpoint_tensors(run, 9)
    assert got.keys() == expected.keys()
    assert not [name for name in expected if not torch.equal(expected[name], got[name])]


def test_a_paused_run_has_the_same_result(
    ball_capture: Path, tmp_path: Path, unbroken: dict[str, torch.Tensor]
) -> None:
    """Catches a pause that changes the samples, a pause that is not saved, and a request to save that ends a pause."""
    run = tmp_path / "run"
    create_run(ball_capture, run, CONFIG)
    seen: list[TrainingState] = []

    def save_and_resume(state: TrainingState) -> None:
        seen.append(state)
        assert is_training(run, state)
        assert (run / "checkpoints" / "00000003.safetensors").exists()
        request(run, "save")  # must not resume
        time.sleep(0.3)
        assert state_of(run).phase == "paused"
        request(run, "resume")

    output = io.StringIO()
    with when_paused(run, save_and_resume):
        train_with(run, 2, lambda: request(run, "pause"), Console(file=output, width=200))
    assert [(state.step, state.max_steps, state.is_held_out) for state in seen] == [(3, 9, True)]
    assert "paused by fourd serve, saved at step 3" in output.getvalue()
    assert "resumed at step 3" in output.getvalue()
    assert_same(run, unbroken)


def test_a_stopped_run_is_resumed(ball_capture: Path, tmp_path: Path, unbroken: dict[str, torch.Tensor]) -> None:
    """Catches a stop that loses steps, and a resumed run that stops again because of the old request."""
    run = tmp_path / "run"
    create_run(ball_capture, run, CONFIG)
    output = io.StringIO()
    with pytest.raises(KeyboardInterrupt):
        train_with(run, 5, lambda: request(run, "stop"), Console(file=output, width=200))
    state = state_of(run)
    assert (state.phase, state.step) == ("stopped", 6)
    assert not is_training(run, state)
    assert "stopped by fourd serve, saved at step 6" in output.getvalue()
    stale = ControlRequest(state.session, "stop")
    train_with(run, 7, lambda: write_request(run, stale))
    assert (state_of(run).phase, state_of(run).step, state_of(run).spent) == ("finished", 9, 1.0)
    assert_same(run, unbroken)


def test_saving_on_request(ball_capture: Path, tmp_path: Path) -> None:
    """Catches a request to save that pauses the run, and a request that is answered again after each step."""
    run = tmp_path / "run"
    create_run(ball_capture, run, CONFIG)
    train_with(run, 2, lambda: request(run, "save"))
    assert sorted(path.name for path in (run / "checkpoints").glob("*.safetensors")) == [
        "00000003.safetensors",
        "00000009.safetensors",
    ]


@pytest.mark.parametrize("content", ["", "{", "[]", '{"session": "x"}', '{"session": 1, "action": "stop"}', "[" * 4000])
def test_a_broken_request_is_reported_once(content: str, tmp_path: Path) -> None:
    """Catches a training that ends because of a broken control file, and a broken control file that is not reported."""
    (tmp_path / "live").mkdir()
    reader = ControlReader(tmp_path, "session")
    assert reader.read() is None
    (tmp_path / "live" / "control.json").write_text(content)
    with pytest.raises(Exception, match=r"control.json: expected a session and one of pause, resume, save, stop, got"):
        reader.read()
    assert reader.read() is None
    write_request(tmp_path, ControlRequest("session", "pause"))
    assert reader.read() == ControlRequest("session", "pause")
    assert reader.read() is None
    write_request(tmp_path, ControlRequest("other", "stop"))
    assert reader.read() is None


def test_requests_before_the_start_are_ignored(tmp_path: Path) -> None:
    """Catches a training that follows a request that was written before the training started."""
    write_request(tmp_path, ControlRequest("session", "stop"))
    assert ControlReader(tmp_path, "session").read() is None
