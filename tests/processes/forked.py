"""Commands in processes of their own that have imported fourd when they start.

Each of these processes is forked from one that has imported :mod:`tests.processes.preloaded`: the imports of a command
need several times as long as a command for a tiny capture.
"""

from __future__ import annotations

import atexit
import multiprocessing
import os
import runpy
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import torch

MAX_SECONDS = 300.0
"""Time in seconds after which a command counts as hanging."""


def start(function: Callable[..., Any], *arguments: Any) -> BaseProcess:
    """Call a function of a module with arguments that can be pickled, in a process of its own."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.processes.preloaded"])
    process = context.Process(target=function, args=arguments)
    process.start()
    return process


def run_together(
    commands: Sequence[Sequence[str]], folder: Path, variables: Sequence[Mapping[str, str]] = ()
) -> list[subprocess.CompletedProcess[str]]:
    """Run commands at the same time, each as ``python -m`` would run it, and wait for all of them.

    Args:
        commands: a module and its arguments for each command.
        folder: folder for the commands' output.
        variables: additional environment variables of each command.
    """
    processes = []
    for number, command in enumerate(commands):
        more = variables[number] if variables else {}
        processes.append(start(_run, list(command), {**os.environ, **more}, folder / f"log {number}"))
    results = []
    for number, (command, process) in enumerate(zip(commands, processes, strict=True)):
        process.join(MAX_SECONDS)
        is_hanging = process.exitcode is None
        process.kill()
        assert not is_hanging, f"{command[0]} has not ended after {MAX_SECONDS:g} s"
        output, errors = ((folder / f"log {number}").with_suffix(end).read_text() for end in (".out", ".err"))
        results.append(subprocess.CompletedProcess(list(command), process.exitcode or 0, output, errors))
    return results


def _run(command: list[str], environment: dict[str, str], log: Path) -> None:
    os.environ.clear()
    os.environ.update(environment)
    redirect(log.with_suffix(".out"), log.with_suffix(".err"))
    torch.set_num_threads(1)
    sys.argv = command
    try:
        runpy.run_module(command[0], run_name="__main__", alter_sys=True)
    finally:
        atexit._run_exitfuncs()  # multiprocessing does not call them
        sys.stdout.flush()
        sys.stderr.flush()


def redirect(output: Path, errors: Path) -> None:
    """Send this process's output and errors to files, also those of C++ libraries. The files may be the same."""
    target = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(target, 1)
    os.dup2(target if errors == output else os.open(errors, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)
    sys.stdout = os.fdopen(1, "w", encoding="utf-8", closefd=False)
    sys.stderr = os.fdopen(2, "w", encoding="utf-8", closefd=False)
