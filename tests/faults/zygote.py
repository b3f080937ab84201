"""A process that has imported fourd once, and that forks for each command. Jobs and results are lines of JSON.

The process has one thread, so that forking is safe.
"""

from __future__ import annotations

import atexit
import faulthandler
import json
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import tests.processes.preloaded  # noqa: F401 -- the forked processes find all modules imported
from fourd.cli import main as cli
from tests.faults.operations import Faults

MAX_SECONDS = 120
"""A command that runs for longer than this time, in seconds, counts as hanging. On an idle machine, a command takes
less than 3 seconds.
"""


def run_job(job: dict[str, Any]) -> dict[str, Any]:
    """Run a command in a forked process. If the job contains a signal, the process gets this signal after
    ``job["seconds"]``. The result contains the wait status of the process.
    """
    child = os.fork()
    if child == 0:
        code = 70
        try:
            code = _run_command(job)
        finally:
            os._exit(code)
    if job["signal"]:
        time.sleep(job["seconds"])
        os.kill(child, job["signal"])
    _, status = os.waitpid(child, 0)
    return {"status": status}


def _run_command(job: dict[str, Any]) -> int:
    signal.signal(signal.SIGINT, signal.default_int_handler)
    log = os.open(job["log"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(log, 1)
    os.dup2(log, 2)
    sys.stdout = os.fdopen(1, "w", encoding="utf-8", closefd=False)
    sys.stderr = os.fdopen(2, "w", encoding="utf-8", closefd=False)
    faulthandler.dump_traceback_later(MAX_SECONDS, exit=True)
    faults = Faults(Path(job["root"]), job["mode"], job["at"])
    faults.install()
    code = 71
    try:
        code = cli.main(job["words"])
    except BaseException as error:
        print(f"Traceback: {type(error).__name__}: {error}", file=sys.stderr)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # fourd.cli.main also ignores SIGINT at its end
    done, faults.at = list(faults.operations), -1
    atexit._run_exitfuncs()  # removes scratch folders, as fourd does when it exits
    sys.stdout.flush()
    sys.stderr.flush()
    Path(job["operations"]).write_text(json.dumps(done))
    return code


def main() -> None:
    print("ready", flush=True)
    for line in sys.stdin:
        print(json.dumps(run_job(json.loads(line))), flush=True)


if __name__ == "__main__":
    main()
