"""Tests that ``fourd make`` gives the same scene with and without interruptions. The command is killed or interrupted
at random times.
"""

from __future__ import annotations

import signal
import time
from pathlib import Path

import numpy as np
import pytest

from tests.captures import write_ball_capture
from tests.faults.chain import MAKE, Runner, leftovers, restore

QUICK, SLOW = 2, 100
CODES = {signal.SIGKILL: (-9, 0), signal.SIGINT: (130, 0)}


def run_kills(tmp_path: Path, rng: np.random.Generator, count: int) -> None:
    """Kill ``count`` calls of fourd make, and interrupt ``count`` other calls. After each of them, another call must
    finish the scene."""
    root, before = tmp_path / "work", tmp_path / "before"
    write_ball_capture(root / "source", cameras=3, frames=1, size=48)
    restore(root, before)
    runner = Runner(tmp_path)
    start = time.monotonic()
    assert runner.run(MAKE, root).code == 0
    seconds = time.monotonic() - start
    scene = (root / "out" / "scene.4dv").read_bytes()
    for number in range(2 * count):
        kind = signal.SIGKILL if number % 2 else signal.SIGINT
        restore(before, root)
        killed = runner.run(MAKE, root, signal=kind, seconds=float(rng.uniform(0.05, seconds)))
        assert killed.code in CODES[kind], killed.text
        assert "Traceback" not in killed.text, killed.text
        again = runner.run(MAKE, root)
        assert again.code == 0, again.text
        assert (root / "out" / "scene.4dv").read_bytes() == scene
        assert leftovers(root) == []


def test_killed_commands_end_with_the_same_scene(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches damaged or lost results of a stage after kill -9 or Ctrl-C at a random time. Also catches leftover files,
    and a scene that differs from the scene of an uninterrupted command.
    """
    run_kills(tmp_path, rng, QUICK)


@pytest.mark.slow
def test_commands_that_are_killed_often_end_with_the_same_scene(tmp_path: Path, rng: np.random.Generator) -> None:
    """Catches the errors of :func:`test_killed_commands_end_with_the_same_scene`, with 100 killed and 100 interrupted
    calls.
    """
    run_kills(tmp_path, rng, SLOW)
