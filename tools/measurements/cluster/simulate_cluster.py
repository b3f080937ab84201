"""Simulate ``fourd make --ray`` on a cluster of several nodes, some of which fail during the run.

    python tools/measurements/cluster/simulate_cluster.py --nodes 16 --failures 8
    python tools/measurements/cluster/simulate_cluster.py --nodes 2 --frames 18000 --seconds 0.2

The simulated stages sleep instead of doing the real work (simulated_stages.py), but the stage graph, the runner, the
tasks and the retries are the same as in ``fourd make``. Each simulated node consists of the processes
of a real Ray node. A failure kills all processes of a random node and adds a new node. The program compares the scene
with that of an uninterrupted run without a cluster. The work of a simulated stage consists of units, each of which
stands for the work between two checkpoints. The program also counts the units that were lost and repeated, and monitors
memory and the progress bar.
"""

from __future__ import annotations

import argparse
import io
import itertools
import random
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

from rich.console import Console

from fourd.pipeline.cluster import join_cluster
from fourd.pipeline.runner import Runner
from fourd.pipeline.stage import Context
from tools.measurements.cluster.local_nodes import TRAINED, LocalNodes, local_nodes, resident_bytes, store_bytes
from tools.measurements.cluster.simulated_stages import Simulation, UnitCounts

MEGABYTE = 1 << 20
BAR = re.compile(r"stages on the cluster[^\n]*?(\d+)/(\d+)")
"""Pattern of the progress bar's text. Its groups are the number of finished stages and the number of all stages."""


@dataclass
class Watched:
    """Measurements that were made during a run.

    Attributes:
        seconds: duration of the run.
        failures: number of nodes that failed.
        samples: memory of the driver and of all object stores in bytes, about once per second.
    """

    seconds: float = 0.0
    failures: int = 0
    samples: list[tuple[int, int]] = field(default_factory=list)


def main() -> None:
    arguments = _parse_arguments()
    with tempfile.TemporaryDirectory() as folder:
        simulation = Simulation(
            Path(folder) / "cluster",
            arguments.cameras,
            arguments.frames,
            arguments.segment,
            arguments.units,
            arguments.seconds,
        )
        simulation.write_capture()
        expected = _expected_scene(simulation)
        text, start = io.StringIO(), time.monotonic()
        with (
            local_nodes(arguments.nodes, 1, patience=arguments.patience) as nodes,
            join_cluster(nodes.address, 1) as cluster,
        ):
            console = Console(file=text, force_terminal=True, width=120, force_interactive=True)
            runner = Runner(Context(console), simulation.folder / "stages.json", cluster.execute, is_parallel=True)
            print(f"{nodes.count()} nodes after {time.monotonic() - start:.0f} s", flush=True)
            watched = run_watched(lambda: simulation.run(runner), nodes, arguments)
        report(simulation, expected, watched, arguments.nodes)
        report_memory(watched.samples)
        report_bar(text.getvalue())


def report(simulation: Simulation, expected: str, watched: Watched, nodes: int) -> None:
    """Print the durations, the result of the scene comparison, and the numbers of lost and repeated units. A unit is
    the part of a stage's work between two checkpoints."""
    counts = simulation.counts()
    segments = {name: found for name, found in counts.items() if name.startswith(TRAINED)}
    others = {name: found for name, found in counts.items() if name not in segments}
    alone = sum(found.units for found in others.values())
    units = sum(found.units for found in counts.values())
    waits = (alone + -(-len(segments) // nodes) * simulation.units) * simulation.seconds
    same = simulation.scene.read_text() == expected
    print(f"{len(segments)} segments and {len(others)} other stages, {units} units of {simulation.seconds:g} s")
    print(f"{watched.seconds:.1f} s; waiting alone takes {waits:.1f} s on {nodes} nodes without failures")
    for name, found in (*others.items(), ("segments of the training", _sum(segments.values()))):
        if found.lost or found.repeated:
            print(f"{name}: {found.units} units, {found.lost} lost, {found.repeated} repeated, {found.redone} redone")
    total = _sum(counts.values())
    verdict = "same" if same else "DIFFERENT"
    print(
        f"{watched.failures} failures; {total.lost} units were lost, {total.repeated} were repeated, {total.redone} of "
        f"them had been finished; scene: {verdict}"
    )
    if not same:
        sys.exit(1)


def _sum(counts: Iterable[UnitCounts]) -> UnitCounts:
    found = list(counts)
    return UnitCounts(*(sum(getattr(each, field.name) for each in found) for field in fields(UnitCounts)))


def report_memory(samples: list[tuple[int, int]]) -> None:
    """Print the largest memory use of the driver and of the object stores in each tenth of the run."""
    tenths = [samples[len(samples) * part // 10 : len(samples) * (part + 1) // 10] for part in range(10)]
    for name, place, unit in (("driver, MB", 0, MEGABYTE), ("object stores, kB", 1, 1024)):
        largest = [f"{max(sample[place] for sample in tenth) / unit:.0f}" for tenth in tenths if tenth]
        print(f"{name}: {' '.join(largest)}")


def report_bar(text: str) -> None:
    """Print the first and the last state of the progress bar, which counts the finished stages. ``text`` is the output
    of the run with all states of the bar. Exit if the bar moved backwards or did not end at its full length."""
    shown = [(int(done), int(count)) for done, count in BAR.findall(text)]
    steady = all(before <= after for (before, _), (after, _) in itertools.pairwise(shown))
    whole = bool(shown) and shown[-1][0] == shown[-1][1]
    print(f"bar: {len(shown)} states, from {shown[0] if shown else None} to {shown[-1] if shown else None}")
    if not (steady and whole):
        sys.exit("the bar went backwards, or did not end at its full length")


def _expected_scene(simulation: Simulation) -> str:
    """Run the simulation in this process, without waiting times, and return its scene."""
    here = replace(simulation, folder=simulation.folder.with_name("here"), seconds=0.0)
    shutil.copytree(simulation.folder, here.folder)
    here.run(Runner(Context(), here.folder / "stages.json"))
    return here.scene.read_text()


def run_watched(run: Callable[[], None], nodes: LocalNodes, arguments: argparse.Namespace) -> Watched:
    """Call ``run`` in a thread. Meanwhile, sample the memory and replace nodes in the main thread, which is the only
    thread in which Ray can start nodes."""
    import grpc
    import ray

    rng, watched = random.Random(arguments.seed), Watched()
    with ThreadPoolExecutor(1) as pool:
        start = time.monotonic()
        running = pool.submit(run)
        failure = start + rng.uniform(0.5, 1.5) * arguments.interval
        while not wait([running], timeout=1.0).done:
            # This sample is skipped if Ray queries a node that was just killed, because the query then raises an error.
            with suppress(grpc.RpcError):
                watched.samples.append((resident_bytes(), store_bytes(ray)))
            if watched.failures < arguments.failures and time.monotonic() > failure:
                busy = nodes.busy() if arguments.busy else []
                nodes.remove(rng.choice(busy or range(nodes.count())))
                watched.failures += 1
                nodes.add()
                failure = time.monotonic() + rng.uniform(0.5, 1.5) * arguments.interval
        watched.seconds = time.monotonic() - start
        running.result()
    return watched


def _parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nodes", type=int, default=16, help="number of nodes with one core each (default 16)")
    parser.add_argument("--cameras", type=int, default=8, help="number of cameras (default 8)")
    parser.add_argument("--frames", type=int, default=7200, help="number of frames of each camera (default 7200)")
    parser.add_argument("--segment", type=int, default=120, help="maximum frames per segment (default 120)")
    parser.add_argument("--units", type=int, default=8, help="units of work per segment (default 8)")
    parser.add_argument("--seconds", type=float, default=2.0, help="seconds that a unit waits (default 2)")
    parser.add_argument("--failures", type=int, default=0, help="number of nodes that fail (default 0)")
    parser.add_argument("--busy", action="store_true", help="choose the failing nodes among those that run a stage")
    parser.add_argument("--interval", type=float, default=10.0, help="mean seconds between failures (default 10)")
    parser.add_argument("--patience", type=int, default=5, help="unanswered checks until a node is lost (default 5)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the failures (default 0)")
    return parser.parse_args()


if __name__ == "__main__":
    main()
