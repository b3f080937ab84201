"""Time the training of a capture's segments with several numbers of workers, and compare it with the cost model.

    fourd synth CAPTURE --frames 240 --cameras 8 --size 96
    python tools/scale/measure_workers.py CAPTURE --workers 1 2 4 --rounds 3 \\
        --segment 48 --points 2000 --steps 100

Each worker is a core of a Ray node on this machine, which may have fewer cores. The stages before training run once.
The numbers of workers then alternate. For each of them, a new run trains all segments with ``fourd make --ray``. The
printed times are those from the start of the first segment to the end of the last one.

On a machine with other programs, workers do not get whole cores. The column "cores left" is the number of cores that
other programs left: all cores, minus the CPU time of other programs, from /proc/stat. Needs Linux.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from fourd.capture import open_capture
from tools.scale.cost_model import Capture, Costs, Machines, makespan, segment_core_s
from tools.scale.local_nodes import PATIENT, local_nodes

SCENE = "scene.4dv"
WORK = "scene.work"
TRAINED = "train "


@dataclass(frozen=True)
class Timing:
    """One training of all segments.

    Attributes:
        workers: number of workers.
        wall_s: seconds from the start of the first segment to the end of the last one.
        own_core_s: CPU seconds of the command and the cluster, from the start to the end of the command.
        others_cores: mean number of cores that other programs used.
    """

    workers: int
    wall_s: float
    own_core_s: float
    others_cores: float


def main() -> None:
    arguments = _parse_arguments()
    capture = arguments.capture.resolve()
    options = ["--segment", arguments.segment, "--points", arguments.points, "--max-steps", arguments.steps]
    words = [sys.executable, "-m", "fourd", "make", capture, "-o", SCENE, *options]
    command = [str(word) for word in words]
    with open_capture(capture) as opened:
        first = opened.cameras[0]
        modelled = Capture(
            len(opened.names),
            opened.frame_count,
            first.width * first.height / 1e6,
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
    """Train all segments of a copy of the prepared folder on a cluster with some workers."""
    shutil.rmtree(folder, ignore_errors=True)
    # The stages compare the times of the files, which the copy keeps.
    shutil.copytree(prepared, folder, copy_function=shutil.copy2)
    own, busy, begin = _own_seconds(), _busy_seconds(), time.monotonic()
    start = end = 0.0
    with local_nodes(1, workers, patience=PATIENT) as nodes:
        process = subprocess.Popen([*command, "--ray", nodes.address], cwd=folder, stdout=subprocess.PIPE, text=True)
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith(TRAINED):
                start, end = start or time.monotonic(), time.monotonic()
        if process.wait() != 0:
            sys.exit(f"exit code {process.returncode}")
    own, busy = _own_seconds() - own, _busy_seconds() - busy
    return Timing(workers, end - start, own, max(busy - own, 0.0) / (time.monotonic() - begin))


def report(timings: Sequence[Timing], capture: Capture) -> None:
    """Print a table of medians, and of the predictions of the cost model."""
    work, count = segment_core_s(Costs.load(), capture), len(capture.segments)
    real = os.cpu_count() or 1
    print(f"{count} segments; predicted: {work:.1f} CPU seconds for each")
    print("| workers | training, s | times the first | cores left | predicted, s | predicted, whole cores, s |")
    print("|---|---|---|---|---|---|")
    base: float | None = None
    for workers in sorted({timing.workers for timing in timings}):
        rows = [timing for timing in timings if timing.workers == workers]
        wall = statistics.median(timing.wall_s for timing in rows)
        left = real - statistics.median(timing.others_cores for timing in rows)
        base = base or wall
        machines = Machines(1, workers, real)
        predicted = makespan([work] * count, workers, min(left, machines.total_cores))
        alone = makespan([work] * count, workers, machines.total_cores)
        print(f"| {workers} | {wall:.0f} | {base / wall:.2f} | {left:.2f} | {predicted:.0f} | {alone:.0f} |")


def _own_seconds() -> float:
    """CPU seconds of this process and of its ended descendants."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def _busy_seconds() -> float:
    """CPU seconds of all programs of this machine since it was started."""
    fields = [int(word) for word in Path("/proc/stat").read_text().splitlines()[0].split()[1:9]]
    idle = fields[3] + fields[4]
    return (sum(fields) - idle) / os.sysconf("SC_CLK_TCK")


def _parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path, help="a capture with masks")
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2, 4], help="numbers of workers (default 1 2 4)")
    parser.add_argument("--rounds", type=int, default=3, help="number of alternating rounds (default 3)")
    parser.add_argument("--segment", type=int, default=48, help="maximum frames of a segment (default 48)")
    parser.add_argument("--points", type=int, default=2000, help="points of a frame (default 2000)")
    parser.add_argument("--steps", type=int, default=100, help="training steps of a segment (default 100)")
    return parser.parse_args()


if __name__ == "__main__":
    main()
