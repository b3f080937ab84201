"""Tests of the process pool. Results must arrive while jobs run, errors of jobs must be raised, and child processes
must end when the parent process ends.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from fourd.base.parallel import run_jobs, split_into_blocks

PARENT = """
import signal
from tests.test_parallel import run_forever
signal.signal(signal.SIGINT, signal.default_int_handler)  # A background job of a shell ignores SIGINT.
run_forever({folder!r})
"""
TIMEOUT_S = 60
"""Time limit of each wait in seconds. The limit is long, because some test machines are slow."""


def squares(job: tuple[int, ...]) -> Iterator[int]:
    for number in job:
        if number < 0:
            raise ValueError(f"{number} is negative")
        yield number * number


def yield_twice(job: Path) -> Iterator[int]:
    """Yield a first result. Yield a second result when the consumer has created the file ``job`` to confirm the
    first."""
    yield 0
    deadline = time.monotonic() + TIMEOUT_S
    while not job.exists():
        assert time.monotonic() < deadline, "the consumer did not get the first result"
        time.sleep(0.01)
    yield 1


def write_forever(job: Path) -> Iterator[int]:
    """Rewrite a file forever. The name of the file is the id of the process."""
    for number in range(10**9):
        (job / str(os.getpid())).write_text(str(number))
        time.sleep(0.01)
        if number == 0:
            yield number


def run_forever(folder: str) -> None:
    for _ in run_jobs(write_forever, [Path(folder), Path(folder)], 2):
        pass


@pytest.mark.parametrize("workers", [1, 2])
def test_results_come_exactly_once(workers: int) -> None:
    """Catches results of jobs that are lost at the end of a job, and duplicated results."""
    jobs = split_into_blocks([*range(9)], 2)
    assert sorted(run_jobs(squares, [tuple(job) for job in jobs], workers)) == [number**2 for number in range(9)]


def test_results_come_before_their_job_ends(tmp_path: Path) -> None:
    """Catches a progress bar that advances only at the end of a job."""
    found = []
    for index, result in enumerate(run_jobs(yield_twice, [tmp_path / "a", tmp_path / "a"], 2)):
        found.append(result)
        if index == 1:
            (tmp_path / "a").touch()
    assert found == [0, 0, 1, 1]


def test_errors_of_jobs_are_raised() -> None:
    """Catches an error in a job that blocks the consumer forever, or that is ignored so that results are missing."""
    with pytest.raises(ValueError, match="-1 is negative"):
        list(run_jobs(squares, [(1,), (-1,), (2,)], 2))


@pytest.mark.parametrize(("stop", "tracebacks"), [(signal.SIGKILL, 0), (signal.SIGINT, 1)])
def test_no_process_outlives_its_parent(stop: signal.Signals, tracebacks: int, tmp_path: Path) -> None:
    """Catches child processes that continue to run after the parent has ended, and tracebacks of child processes."""
    command = [sys.executable, "-c", PARENT.format(folder=str(tmp_path))]
    parent = subprocess.Popen(command, stderr=subprocess.PIPE, start_new_session=True)
    deadline = time.monotonic() + TIMEOUT_S
    while len(list(tmp_path.iterdir())) < 2:
        assert time.monotonic() < deadline, "the processes did not start"
        time.sleep(0.01)
    if stop == signal.SIGKILL:
        parent.kill()  # If memory is short, the operating system kills only the parent.
    else:
        os.killpg(parent.pid, stop)  # Ctrl-C in a terminal stops the parent and its children.
    # The call returns when the last process has closed its stderr.
    errors = parent.communicate(timeout=TIMEOUT_S)[1].decode()
    assert errors.count("Traceback") == tracebacks, errors
