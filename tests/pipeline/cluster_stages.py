"""Work of the stages that tests run on a cluster. A worker process imports only this module and Ray, because importing
torch and the tests takes it seconds."""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import dataclass
from pathlib import Path

from fourd.base.errors import UserError
from fourd.pipeline.stage import Context, NoSettings


@dataclass(frozen=True)
class CounterFiles:
    count: Path


def fail(files: CounterFiles, settings: NoSettings, context: Context) -> None:
    raise UserError(f"{files.count}: expected something else")


def stop(files: CounterFiles, settings: NoSettings, context: Context) -> None:
    raise KeyboardInterrupt


def report_process(files: CounterFiles, settings: NoSettings, context: Context) -> None:
    """Print the process id, and the number of threads that torch has or will have when it is imported."""
    torch = sys.modules.get("torch")
    context.log(f"{os.getpid()} {torch.get_num_threads() if torch else os.environ['OMP_NUM_THREADS']}")


def die_once(files: CounterFiles, settings: NoSettings, context: Context) -> None:
    """Kill this process in the first call. In the second call, finish the work."""
    if not files.count.exists():
        files.count.write_text("1")
        os.kill(os.getpid(), signal.SIGKILL)
    files.count.write_text("2")
    context.log(f"cores {context.workers}, threads {os.environ['OMP_NUM_THREADS']}")
