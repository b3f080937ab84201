"""Runs the programs in examples/."""

from __future__ import annotations

import contextlib
import io
import os
import runpy
import subprocess
import sys
from pathlib import Path

EXAMPLES = Path(__file__).parents[2] / "examples"


def run_here(script: str, *arguments: object) -> str:
    """Run an example in this process as ``python SCRIPT ARGUMENTS`` runs it, and return its standard output.

    A process of its own would need more time to import torch than most examples need to run.
    """
    program = EXAMPLES / script
    before, printed = (sys.argv, sys.path, set(sys.modules)), io.StringIO()
    sys.argv = [str(program), *map(str, arguments)]
    sys.path = [str(program.parent), *sys.path]
    try:
        with contextlib.redirect_stdout(printed):
            runpy.run_path(str(program), run_name="__main__")
    finally:
        sys.argv, sys.path = before[:2]
        for name in sys.modules.keys() - before[2]:
            if str(EXAMPLES) in (getattr(sys.modules[name], "__file__", None) or ""):
                del sys.modules[name]
    return printed.getvalue()


def run_python(*words: object) -> str:
    """Run Python with the arguments ``words`` in a process of its own, and return its standard output."""
    environment = {**os.environ, "PYTHONPATH": str(EXAMPLES.parent), "COLUMNS": "120"}
    command = [sys.executable, *map(str, words)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


HELP = """
import runpy, sys
program = sys.argv[1]
for script in sys.argv[2:]:
    sys.argv = [script, "--help"]
    sys.path[0] = script.rpartition("/")[0]
    print(program, script)
    try:
        runpy.run_path(script, run_name="__main__")
    except SystemExit as end:
        assert not end.code, script
"""
"""One process asks several programs for their help, because importing torch takes longer than the rest."""


def help_of(scripts: list[str]) -> dict[str, str]:
    """Help of each program. A program that does not print its help fails the test that asks."""
    separator = "--- program"
    parts = run_python("-c", HELP, separator, *((EXAMPLES / script).as_posix() for script in scripts)).split(separator)
    return dict(zip(scripts, parts[1:], strict=True))
