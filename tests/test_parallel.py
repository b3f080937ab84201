"""Work in processes: results while jobs run, failures that are told, and no process that outlives a stop."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from fourd.parallel import run_jobs, split_into_blocks

PARENT = """
import signal
from tests.test_parallel import spread_for_ever
signal.signal(signal.SIGINT, signal.default_int_handler)  # which a shell's background job does not have
spread_for_ever({folder!r})
"""
PATIENCE_S = 60
"""That a slow machine may take for what is waited for."""


def squares(job: tuple[int, ...]) -> Iterator[int]:
    for number in job:
        if number < 0:
            raise ValueError(f"{number} is negative")
        yield number * number


def in_turns(job: Path) -> Iterator[int]:
    """A result, and a second one once the consumer has left a file to say that it has the first."""
    yield 0
    deadline = time.monotonic() + PATIENCE_S
    while not job.exists():
        assert time.monotonic() < deadline, "nobody took the first result"
        time.sleep(0.01)
    yield 1


def without_end(job: Path) -> Iterator[int]:
    """Rewrites a file named after its process for ever."""
    for number in range(10**9):
        (job / str(os.getpid())).write_text(str(number))
        time.sleep(0.01)
        if number == 0:
            yield number


def spread_for_ever(folder: str) -> None:
    for _ in run_jobs(without_end, [Path(folder), Path(folder)], 2):
        pass


@pytest.mark.parametrize("workers", [1, 2])
def test_all_results_come_once(workers: int) -> None:
    """Catches results that are lost at the end of a job, or told twice."""
    jobs = split_into_blocks([*range(9)], 2)
    assert sorted(run_jobs(squares, [tuple(job) for job in jobs], workers)) == [number**2 for number in range(9)]


def test_results_come_while_their_job_goes_on(tmp_path: Path) -> None:
    """Catches a bar that stands still for the length of a job and then leaps."""
    found = []
    for place, result in enumerate(run_jobs(in_turns, [tmp_path / "a", tmp_path / "a"], 2)):
        found.append(result)
        if place == 1:
            (tmp_path / "a").touch()
    assert found == [0, 0, 1, 1]


def test_a_job_that_fails_is_told() -> None:
    """Catches a failure that is waited for without end, and mattes that are silently left out."""
    with pytest.raises(ValueError, match="-1 is negative"):
        list(run_jobs(squares, [(1,), (-1,), (2,)], 2))


@pytest.mark.parametrize(("how", "tracebacks"), [(signal.SIGKILL, 0), (signal.SIGINT, 1)])
def test_no_process_outlives_a_stop(how: signal.Signals, tracebacks: int, tmp_path: Path) -> None:
    """Catches orphans that go on writing beside the command that was called again, and tracebacks of children."""
    command = [sys.executable, "-c", PARENT.format(folder=str(tmp_path))]
    parent = subprocess.Popen(command, stderr=subprocess.PIPE, start_new_session=True)
    deadline = time.monotonic() + PATIENCE_S
    while len(list(tmp_path.iterdir())) < 2:
        assert time.monotonic() < deadline, "the processes did not begin"
        time.sleep(0.01)
    if how == signal.SIGKILL:
        parent.kill()  # alone, as the system does when memory is short
    else:
        os.killpg(parent.pid, how)  # and its children, as a terminal does
    told = parent.communicate(timeout=PATIENCE_S)[1].decode()  # ends when the last process has closed its stderr
    assert told.count("Traceback") == tracebacks, told
