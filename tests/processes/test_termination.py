"""Commands that are ended by the signal SIGTERM, as batch systems and containers do."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

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
