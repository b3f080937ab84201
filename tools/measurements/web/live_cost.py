"""Measure how much the web page of a run slows down training while it is open.

    python tools/measurements/web/live_cost.py CAPTURE --windows 12 --seconds 20 -- --scale 0.5 --points 12000

The program trains CAPTURE with the options after `--`, and starts `fourd serve` for the run. The training time is
divided into pairs of time windows. --windows is the number of pairs, and --seconds is the length of each window. In one
window of each pair, the program sends requests to the server as often as an open page would. In the other, the server
process is stopped (SIGSTOP). The program prints the training speeds with and without the page, and their ratio. The
speed is measured in steps per second of training time, and again in steps per second of CPU time, which depends less on
other programs. With --browser, Chromium sends the requests instead: it shows the page in one window of each pair, and
an empty page in the other. With --scene, the program also requests the scene's data. With --browser and --scene,
Chromium opens the page's scene tab.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from fourd.reconstruction.training.live.state import read_state
from tools.measurements.cluster.command_line import parse_with_options
from tools.measurements.cluster.local_nodes import cpu_seconds

PAGE_SECONDS = 2.0
"""Interval in seconds between the page's requests."""
SETTLE_SECONDS = 3.0
"""Seconds between the start of a time window, in which the page is either open or closed, and the start of the
measurement in this window."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("capture", type=Path)
    parser.add_argument("--windows", type=int, default=12, help="number of pairs of windows")
    parser.add_argument("--seconds", type=float, default=20.0, help="length of a window")
    parser.add_argument("--browser", action="store_true", help="show the page in Chromium")
    parser.add_argument("--scene", action="store_true", help="also request the scene")
    arguments = parse_with_options(parser)
    with tempfile.TemporaryDirectory() as temporary:
        run = Path(temporary) / "run"
        watching = browsing if arguments.browser else asking
        with (
            training(arguments.capture, run, arguments.options) as trainer,
            serving(run) as (server, url),
            watching(url, arguments.scene) as watch,
        ):
            measure(run, (trainer, server), watch, arguments.windows, arguments.seconds)


def measure(run: Path, processes: tuple[int, int], watch: Callable[[bool], None], windows: int, seconds: float) -> None:
    """Print the training speeds with the page open and with the page closed, measured in pairs of time windows, and the
    CPU time of the server.

    Args:
        run: the run's folder.
        processes: the process ids of the training run and of the server.
        watch: function that opens (True) or closes (False) the page, or starts and stops its requests.
        windows: number of pairs of windows.
        seconds: length of a window.
    """
    trainer, server = processes
    found: dict[bool, list[tuple[float, float]]] = {False: [], True: []}
    trained = served = 0.0
    for pair in range(windows):
        for watched in (False, True) if pair % 2 == 0 else (True, False):
            os.kill(server, signal.SIGCONT if watched else signal.SIGSTOP)
            watch(watched)
            time.sleep(SETTLE_SECONDS)
            (step, time_before), cpu, served_before = next_record(run), cpu_seconds(trainer), cpu_seconds(server)
            time.sleep(seconds)
            (last, time_after), cpu_after = next_record(run), cpu_seconds(trainer)
            found[watched].append(((last - step) / (time_after - time_before), (last - step) / (cpu_after - cpu)))
            if watched:
                trained += cpu_after - cpu
                served += cpu_seconds(server) - served_before
        print(f"{found[False][-1]} {found[True][-1]}", flush=True)
    os.kill(server, signal.SIGCONT)
    for index, unit in enumerate(("second of training time", "second of CPU time of the training")):
        speeds = {watched: [pair[index] for pair in pairs] for watched, pairs in found.items()}
        ratios = [b / a for a, b in zip(speeds[False], speeds[True], strict=True)]
        quarters = statistics.quantiles(ratios, n=4) if len(ratios) > 1 else [ratios[0]] * 3
        print(
            f"steps per {unit}: {statistics.median(speeds[False]):.2f} not watched, "
            f"{statistics.median(speeds[True]):.2f} watched; ratio of neighbouring windows: median {quarters[1]:.3f}, "
            f"quartiles {quarters[0]:.3f} to {quarters[2]:.3f}"
        )
    print(f"CPU time of the server while it is watched: {100 * served / trained:.2f} % of that of the training")


@contextmanager
def training(capture: Path, run: Path, options: Sequence[str]) -> Iterator[int]:
    """Start training, and yield its process id after 50 steps. Training ends together with the ``with`` block."""
    command = [sys.executable, "-m", "fourd.cli.main", "train", str(capture), "-o", str(run)]
    process = subprocess.Popen([*command, "--max-steps", "10000000", *options], stdout=sys.stderr)
    try:
        while (state := read_state(run)) is None or state.step < 50:
            if process.poll() is not None:
                sys.exit("fourd train ended")
            time.sleep(0.5)
        yield process.pid
    finally:
        process.terminate()  # sends SIGTERM, because SIGINT is ignored if a shell has started this program with &
        process.wait()


@contextmanager
def serving(run: Path) -> Iterator[tuple[int, str]]:
    """Serve a run. Yields the process id and the address of the page."""
    words = [sys.executable, "-m", "fourd.cli.main", "serve", str(run), "--port", "0", "--no-browser"]
    process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    match = re.search(r"http://[^:]*:\d+/", process.stderr.readline())
    assert match is not None, "expected the address of the page"
    threading.Thread(target=process.stderr.read, daemon=True).start()
    try:
        yield process.pid, match[0]
    finally:
        process.send_signal(signal.SIGCONT)
        process.terminate()  # sends SIGTERM, because SIGINT is ignored if a shell has started this program with &
        process.wait()


@contextmanager
def asking(url: str, with_scene: bool) -> Iterator[Callable[[bool], None]]:
    """Yield a function that starts (True) or stops (False) sending the page's requests to the server."""
    is_asking, ended = threading.Event(), threading.Event()
    threading.Thread(target=ask, args=(url, with_scene, is_asking, ended), daemon=True).start()
    yield lambda watched: is_asking.set() if watched else is_asking.clear()
    ended.set()


def ask(url: str, with_scene: bool, is_asking: threading.Event, ended: threading.Event) -> None:
    """Send the requests of the page every two seconds while ``is_asking`` is set."""
    seen: list[int] = []
    while not ended.wait(PAGE_SECONDS):
        if not is_asking.is_set():
            continue
        status = json.loads(urllib.request.urlopen(f"{url}run/status.json", timeout=60).read())
        urllib.request.urlopen(f"{url}run/curves.json", timeout=60).read()
        if with_scene:
            urllib.request.urlopen(f"{url}run/scene.json", timeout=60).read()
        for step in set(status["pictures"][-1:]) - set(seen):
            urllib.request.urlopen(f"{url}run/pictures/{step}.jpg", timeout=60).read()
            seen.append(step)


@contextmanager
def browsing(url: str, with_scene: bool) -> Iterator[Callable[[bool], None]]:
    """Start Chromium. Yield a function that opens the page of the run (True) or an empty page (False)."""
    from tools.measurements.web.pages import open_browser

    with open_browser() as browser:
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        address = url + ("?tab=scene" if with_scene else "")
        yield lambda watched: page.goto(address if watched else "about:blank")


def next_record(run: Path) -> tuple[int, float]:
    """Wait until the log has a new record of a training step. Return its step and its training time in seconds."""
    with (run / "metrics.jsonl").open() as stream:
        stream.seek(0, os.SEEK_END)
        line = ""
        while True:
            line += stream.readline()
            if not line.endswith("\n"):
                time.sleep(0.01)
                continue
            if "psnr_smooth" in (record := json.loads(line)):
                return record["step"], record["seconds"]
            line = ""


if __name__ == "__main__":
    main()
