"""Tests with hostile files and command lines. Each command must end with one error line and exit code 2, use little
memory and time, and change no file outside the output.
"""

from __future__ import annotations

import os
import resource
import signal
import sys
from itertools import chain
from pathlib import Path

import pytest

from fourd.cli.main import main
from tests.hostile.classes import HostileClasses
from tests.hostile.files import Case, HostileFiles

MAX_SECONDS = 10
MAX_BYTES = 2 << 30


def run_case(case: Case, log: Path) -> str:
    """Run a command in a child process. Returns a description of the fault, or an empty string."""
    child = os.fork()
    if child == 0:
        # The child never returns to pytest.
        code = 70
        try:
            stream = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(stream, 1)
            os.dup2(stream, 2)
            sys.stdout = os.fdopen(1, "w", encoding="utf-8", errors="backslashreplace", closefd=False)
            sys.stderr = os.fdopen(2, "w", encoding="utf-8", errors="backslashreplace", closefd=False)
            signal.alarm(6 * MAX_SECONDS)
            code = main(case.words)
        except BaseException as error:
            os.write(2, f"Traceback: {type(error).__name__}: {error}\n".encode(errors="replace"))
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
    _, status, usage = os.wait4(child, 0)
    return find_fault(case, status, usage, log.read_text(encoding="utf-8", errors="replace"))


def find_fault(case: Case, status: int, usage: resource.struct_rusage, text: str) -> str:
    if os.WIFSIGNALED(status):
        return f"signal {os.WTERMSIG(status)}"
    code = os.WEXITSTATUS(status)
    if "Traceback" in text:
        return f"traceback: {text.strip().splitlines()[-1][:200]}"
    if code not in case.codes:
        return f"exit code {code}: {text.strip()[-200:]}"
    if code == 2 and sum(line.startswith(f"fourd {case.words[0]}: ") for line in text.splitlines()) != 1:
        return f"not one line: {text.strip()[-200:]}"
    if "\x1b" in text or "\x07" in text:
        return "control characters in the output"
    if usage.ru_utime + usage.ru_stime > MAX_SECONDS:
        return f"{usage.ru_utime + usage.ru_stime:.1f} s of processor time"
    if usage.ru_maxrss * 1024 > MAX_BYTES:
        return f"{usage.ru_maxrss / 2**20:.1f} GB of memory"
    return ""


@pytest.mark.slow
def test_hostile_files_end_with_one_line(tmp_path: Path) -> None:
    """Catches tracebacks, crashes, hangs, unbounded memory, and files that are deleted outside the capture."""
    hostile = HostileFiles(tmp_path)
    faults, count = {}, 0
    for case in chain(hostile.cases(), HostileClasses(hostile).cases()):
        fault = run_case(case, tmp_path / "log")
        count += 1
        if fault:
            faults[case.name] = fault
    assert not faults, "\n".join(f"{name}: {fault}" for name, fault in faults.items())
    assert count > 300
    assert (tmp_path / "outside" / "precious").read_text() == "kept"
    assert not (tmp_path / "out").exists()
