"""Kill workers and drivers of ``fourd make --ray`` at random times, and check that this does not change the scene.

    fourd synth CAPTURE --frames 84 --cameras 4 --size 48
    python tools/measurements/cluster/random_kills.py CAPTURE --workers 20 --drivers 20 \\
        -- --segment 12 --points 500 --max-steps 20

First, the command runs once without kills. Then it is repeated until all kills (SIGKILL) are done. If a worker (the
process of a running stage) is killed, Ray starts the stage again. If the driver (the process of the command) is killed,
the program starts the same command again at once. The cluster is one node with two cores on this machine. The exit code
is 1 if a scene differs from the scene of the first run, or if a segment that was finished before a kill was trained
again.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from fourd.pipeline.cluster import RETRIES
from tools.measurements.cluster.command_line import parse_with_options
from tools.measurements.cluster.local_nodes import PATIENT, TRAINED, LocalNodes, local_nodes

CORES = 2
KILLS_HELP = "mean number of kills in the time that the uninterrupted command needs (default 12)"
KEPT = Path("random_kills_failed")
"""Folder to which the results are copied if a check fails."""


@dataclass(frozen=True)
class Command:
    """A call of ``fourd make`` on the cluster at ``address``, and the folder of its scene."""

    capture: Path
    folder: Path
    address: str
    options: tuple[str, ...]

    @property
    def scene(self) -> Path:
        return self.folder / "scene.4dv"

    @property
    def work(self) -> Path:
        return self.folder / "scene.work"

    def start(self) -> subprocess.Popen[str]:
        """Start the command, and append its output to a file."""
        words = [sys.executable, "-m", "fourd", "make", self.capture, "-o", self.scene, "--ray", self.address]
        self.folder.mkdir(exist_ok=True)
        with (self.folder / "output").open("a") as out:
            return subprocess.Popen(
                [*map(str, words), *self.options], stdout=out, stderr=subprocess.STDOUT, cwd=self.folder, text=True
            )

    def finish(self, process: subprocess.Popen[str]) -> None:
        """Wait until the command has ended, and check that it has succeeded."""
        if process.wait() != 0:
            sys.exit(f"exit code {process.returncode}\n{(self.folder / 'output').read_text()[-2000:]}")

    def finished_segments(self) -> dict[str, dict[str, int]]:
        """Return, for each finished training stage, a mapping from its checkpoint files to their modification times."""
        record = self.work / "stages.json"
        stages = json.loads(record.read_text())["stages"] if record.exists() else {}
        trained = [name for name, entry in stages.items() if name.startswith(TRAINED) and entry["finished"] is not None]
        return {name: self._checkpoints(name.removeprefix(TRAINED)) for name in trained}

    def _checkpoints(self, segment: str) -> dict[str, int]:
        folder = self.work / "run" / "segments" / segment / "checkpoints"
        return {path.name: path.stat().st_mtime_ns for path in folder.rglob("*")}


def main() -> None:
    arguments = _parse_arguments()
    rng = random.Random(arguments.seed)
    kinds = ["worker"] * arguments.workers + ["driver"] * arguments.drivers
    rng.shuffle(kinds)
    with tempfile.TemporaryDirectory() as folder, local_nodes(1, CORES, patience=PATIENT) as nodes:
        command = Command(arguments.capture.resolve(), Path(folder) / "out", nodes.address, arguments.options)
        start = time.monotonic()
        command.finish(command.start())
        seconds = time.monotonic() - start
        expected = command.scene.read_bytes()
        print(f"uninterrupted: {seconds:.0f} s, {len(command.finished_segments())} segments", flush=True)
        killed: list[str] = []
        while len(killed) < len(kinds):
            shutil.rmtree(command.folder)
            before, start = len(killed), time.monotonic()
            repeated = run_with_kills(
                command, nodes, kinds, killed, lambda: rng.uniform(0, 2 * seconds / arguments.kills)
            )
            same = command.scene.read_bytes() == expected
            print(f"{time.monotonic() - start:.0f} s, killed: {', '.join(killed[before:])}", flush=True)
            verdict = "same" if same else "DIFFERENT"
            print(f"finished segments that were repeated: {repeated or 'none'}; scene: {verdict}", flush=True)
            if repeated or not same:
                shutil.copytree(command.folder, KEPT, dirs_exist_ok=True)
                sys.exit(f"{KEPT}: has the results")
    print(f"killed {arguments.workers} workers and {arguments.drivers} drivers")


def run_with_kills(
    command: Command, nodes: LocalNodes, kinds: Sequence[str], killed: list[str], interval: Callable[[], float]
) -> list[str]:
    """Run the command until it has succeeded, and meanwhile kill processes.

    ``kinds`` contains "worker" or "driver" for each kill, and ``interval`` returns the number of seconds until the next
    one. A description of each kill is appended to the list ``killed``. Returns the names of the finished segments that
    were trained again.
    """
    process, deadline = command.start(), time.monotonic() + interval()
    kept: dict[str, dict[str, int]] = {}
    victims: list[str] = []
    while process.poll() is None:
        time.sleep(0.02)
        if len(killed) == len(kinds) or time.monotonic() < deadline:
            continue
        running = {pid: name for pid, name in nodes.stages().items() if victims.count(name) < RETRIES}
        if not running:
            continue
        # ``kept`` has the finished segments, which must not be trained again. Only the segment whose process is killed
        # next may be trained again, so it is removed from ``kept``. It is in ``kept`` if it has finished since
        # ``running`` was read.
        kept = {**command.finished_segments(), **kept}
        pid, name = min(running.items(), key=lambda item: (victims.count(item[1]), item))
        if kinds[len(killed)] == "worker":
            os.kill(pid, signal.SIGKILL)
            kept.pop(name, None)
            victims.append(name)
        else:
            process.send_signal(signal.SIGKILL)
            process.wait()
            process, victims = command.start(), []
        killed.append(f"{kinds[len(killed)]} at {name}")
        deadline = time.monotonic() + interval()
    command.finish(process)
    finished = command.finished_segments()
    return [name for name, files in kept.items() if finished.get(name) != files]


def _parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path, help="a capture with masks")
    parser.add_argument("--workers", type=int, default=20, help="number of killed workers (default 20)")
    parser.add_argument("--drivers", type=int, default=20, help="number of killed drivers (default 20)")
    parser.add_argument("--kills", type=float, default=12.0, help=KILLS_HELP)
    parser.add_argument("--seed", type=int, default=0, help="seed of the random moments of the kills (default 0)")
    parser.epilog = "The words after -- are options of fourd make."
    return parse_with_options(parser)


if __name__ == "__main__":
    main()
