"""Measure how long it takes different numbers of workers to train a capture's segments, and compare the durations with
the cost model.

    fourd synth CAPTURE --frames 240 --cameras 8 --size 96
    python tools/measurements/cluster/measure_workers.py CAPTURE --workers 1 2 4 --rounds 3 \\
        --segment 48 --points 2000 --steps 300

A worker is one core of a Ray node on this machine. There can be more workers than the machine has cores. The stages
before training run only once. After them, in each round and for each number of workers, ``fourd make --ray`` trains all
segments of a new run.

Durations are measured from the start of the first segment to the end of the last. Other programs on the machine change
the durations, but hardly the CPU seconds. The column "on whole cores" is therefore computed from the CPU seconds of the
segments, and estimates the duration on a machine that runs no other programs. Needs Linux.
"""

from __future__ import annotations

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from fourd.base.processes import called_every
from fourd.recording.capture import open_capture
from tools.measurements import tables
from tools.measurements.cluster.command_line import parse_with_options
from tools.measurements.cluster.cost_model import Capture, Costs, makespan, segments_core_s
from tools.measurements.cluster.local_nodes import PATIENT, TRAINED, LocalNodes, cpu_seconds, local_nodes

SCENE = "scene.4dv"
WORK = "scene.work"
SAMPLED_S = 0.25
"""Seconds between two readings of CPU times."""


@dataclass(frozen=True)
class Timing:
    """The timing of one training run over all segments.

    Attributes:
        workers: number of workers.
        wall_s: seconds from the start of the first segment to the end of the last one.
        core_s: CPU seconds of each segment.
    """

    workers: int
    wall_s: float
    core_s: tuple[float, ...]


class SegmentClock:
    """Measures the CPU seconds of segments from the CPU times of their processes. A process can train several segments,
    one after another."""

    def __init__(self) -> None:
        self._segments: dict[str, float] = {}
        self._processes: dict[int, float] = {}

    @property
    def core_s(self) -> tuple[float, ...]:
        """CPU seconds of each segment so far, in the order of the segments. The time to start a process counts towards
        its first segment."""
        return tuple(self._segments[name] for name in sorted(self._segments))

    def read(self, nodes: LocalNodes) -> None:
        """Read the CPU times of the processes that train segments. For each segment, add the time spent since the last
        call."""
        for pid, name in nodes.stages().items():
            if name.startswith(TRAINED):
                with suppress(OSError):  # The process has ended.
                    now = cpu_seconds(pid)
                    spent = now - self._processes.get(pid, 0.0)
                    self._segments[name] = self._segments.get(name, 0.0) + spent
                    self._processes[pid] = now


def main() -> None:
    arguments = _parse_arguments()
    capture = arguments.capture.resolve()
    options = ["--segment", arguments.segment, "--points", arguments.points, "--max-steps", arguments.steps]
    options += ["--scale", arguments.scale, *arguments.options]
    words = [sys.executable, "-m", "fourd", "make", capture, "-o", SCENE, *options]
    command = [str(word) for word in words]
    with open_capture(capture) as opened:
        first = opened.cameras[0]
        modelled = Capture(
            len(opened.names),
            opened.frame_count,
            first.width * first.height / 1e6,
            scale=arguments.scale,
            points=arguments.points,
            segment=arguments.segment,
            steps=arguments.steps,
            has_mattes=True,
            has_videos=False,
        )
    timings: list[Timing] = []
    with tempfile.TemporaryDirectory() as folder:
        prepared = Path(folder) / "prepared"
        prepare(command, prepared)
        for number in range(arguments.rounds):
            order = arguments.workers if number % 2 == 0 else arguments.workers[::-1]
            for workers in order:
                timings.append(train(command, prepared, Path(folder) / "run", workers))
                print(timings[-1], flush=True)
    report(timings, modelled)


def prepare(command: Sequence[str], folder: Path) -> None:
    """Run all stages before training, and stop when the first segment starts."""
    folder.mkdir()
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    for line in process.stdout:
        if line.startswith(TRAINED):
            break
    process.kill()
    process.wait()
    shutil.rmtree(folder / WORK / "run" / "segments", ignore_errors=True)


def train(command: Sequence[str], prepared: Path, folder: Path, workers: int) -> Timing:
    """Copy the prepared folder to ``folder``, and train all segments there on a cluster with ``workers`` workers."""
    shutil.rmtree(folder, ignore_errors=True)
    # copy2 keeps modification times, which stages compare to find out if they must run again.
    shutil.copytree(prepared, folder, copy_function=shutil.copy2)
    clock = SegmentClock()
    start = end = 0.0
    with local_nodes(1, workers, patience=PATIENT) as nodes:
        process = subprocess.Popen([*command, "--ray", nodes.address], cwd=folder, stdout=subprocess.PIPE, text=True)
        with called_every(SAMPLED_S, lambda: clock.read(nodes)):
            assert process.stdout is not None
            for line in process.stdout:
                if line.startswith(TRAINED):
                    start, end = start or time.monotonic(), time.monotonic()
        if process.wait() != 0:
            sys.exit(f"exit code {process.returncode}")
    return Timing(workers, end - start, clock.core_s)


def report(timings: Sequence[Timing], capture: Capture) -> None:
    """Print a table of the measured medians and the predictions of the cost model."""
    real = os.cpu_count() or 1
    titles = ["workers", "CPU seconds of a segment", "on whole cores, s", "times the first"]
    print(tables.head([*titles, "predicted, s", "measured, s"]))
    base: float | None = None
    for workers in sorted({timing.workers for timing in timings}):
        rows = [timing for timing in timings if timing.workers == workers]
        core_s = statistics.median(seconds for timing in rows for seconds in timing.core_s)
        whole = statistics.median(makespan(timing.core_s, workers, real) for timing in rows)
        wall = statistics.median(timing.wall_s for timing in rows)
        base = base or whole
        predicted = makespan(segments_core_s(Costs.load(), capture, workers), workers, real)
        cells = [f"{core_s:.1f}", f"{whole:.0f}", f"{base / whole:.2f}", f"{predicted:.0f}", f"{wall:.0f}"]
        print(tables.row([workers, *cells]))


def _parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path, help="a capture with masks")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4], help="numbers of workers (default 1 2 4)")
    parser.add_argument("--rounds", type=int, default=3, help="number of alternating rounds (default 3)")
    parser.add_argument("--segment", type=int, default=48, help="maximum frames per segment (default 48)")
    parser.add_argument("--points", type=int, default=2000, help="points per frame (default 2000)")
    parser.add_argument("--steps", type=int, default=100, help="training steps per segment (default 100)")
    parser.add_argument("--scale", type=float, default=1.0, help="scale of the images in training (default 1)")
    parser.epilog = "The words after -- are further options of fourd make."
    return parse_with_options(parser)


if __name__ == "__main__":
    main()
