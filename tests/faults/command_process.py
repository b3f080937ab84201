"""Runs one command of fourd, one of whose operations on files may fail, in a process of its own."""

from __future__ import annotations

import atexit
import faulthandler
import json
import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path

from fourd.cli import main as cli
from tests.faults.operations import Faults, Mode
from tests.processes.forked import redirect

MAX_SECONDS = 120
"""A command that runs for longer than this time, in seconds, counts as hanging. On an idle machine, a command takes
less than 3 seconds.
"""
ONE_THREAD = {"OMP_NUM_THREADS": "1", "FOURD_THREADS": "1", "PYTHONDONTWRITEBYTECODE": "1"}


@dataclass(frozen=True)
class Job:
    """A command, and the operation that fails.

    Attributes:
        words: the command and its arguments.
        root: the folder whose operations are counted.
        mode: the kind of the fault.
        at: index of the operation that gets the fault, or -1.
        log: file for the output of the command.
        operations: file for the list of operations, which is not written if the command is killed.
    """

    words: tuple[str, ...]
    root: Path
    mode: Mode
    at: int
    log: Path
    operations: Path


def run_job(job: Job) -> None:
    """Run a command, and end this process with its exit code."""
    code = 70
    try:
        code = _run_command(job)
    finally:
        os._exit(code)


def _run_command(job: Job) -> int:
    os.environ.update(ONE_THREAD)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    redirect(job.log, job.log)
    faulthandler.dump_traceback_later(MAX_SECONDS, exit=True)
    faults = Faults(job.root, job.mode, job.at)
    faults.install()
    code = 71
    try:
        code = cli.main(list(job.words))
    except BaseException as error:
        print(f"Traceback: {type(error).__name__}: {error}", file=sys.stderr)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # fourd.cli.main also ignores SIGINT at its end
    done, faults.at = list(faults.operations), -1
    atexit._run_exitfuncs()  # removes scratch folders, as fourd does when it exits
    sys.stdout.flush()
    sys.stderr.flush()
    job.operations.write_text(json.dumps(done))
    return code
