"""Commands that are ended by the signal SIGTERM, as batch systems and containers do."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from fourd.cli.main import main
from fourd.reconstruction.training.checkpoints import checkpoint_files

DEADLINE_SECONDS = 200


def test_training_saves_a_checkpoint_before_it_ends(ball_capture: Path, tmp_path: Path) -> None:
    """Catches lost training steps, and the stack trace of a C++ library that handles SIGTERM since it was imported."""
    run = tmp_path / "run"
    options = ("--points", "300", "--max-steps", "1000000", "--set", "checkpoint_seconds=1e6")
    command = [sys.executable, "-m", "fourd", "train", str(ball_capture), "-o", str(run), *options]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + DEADLINE_SECONDS
    metrics = run / "metrics.jsonl"
    while not (metrics.exists() and metrics.read_text()):
        assert process.poll() is None, "training has ended before it could be terminated"
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=DEADLINE_SECONDS)
    assert process.returncode == 130
    assert errors == "fourd train: interrupted; finished results are kept\n"
    assert [int(path.stem) >= 10 for path in checkpoint_files(run / "checkpoints")] == [True]


def test_an_interrupt_that_became_another_error_is_reported_as_an_interrupt(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches a traceback after Ctrl-C: torch's C++ code replaces KeyboardInterrupt by a ValueError."""

    def interrupted(command: str, words: list[str]) -> int:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise ValueError("could not determine the shape of object type 'torch.storage.UntypedStorage'") from None
        return 0

    monkeypatch.setattr("fourd.cli.main._run", interrupted)
    assert main(["bake"]) == 130
    assert capsys.readouterr().err == "fourd bake: interrupted; finished results are kept\n"


def test_an_error_without_an_interrupt_is_not_called_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Catches a bug of fourd that is reported as an interrupt, because an earlier command was interrupted."""

    def fails(command: str, words: list[str]) -> int:
        raise ValueError("a bug")

    monkeypatch.setattr("fourd.cli.main._run", fails)
    with pytest.raises(ValueError, match="a bug"):
        main(["bake"])
