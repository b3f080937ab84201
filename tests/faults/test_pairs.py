"""Tests that two calls of ``calibrate``, ``view``, ``bench`` and ``serve`` on the same files do not disturb each other.
The other commands are tested in test_faults.py.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest

from fourd.base.progress import untracked
from fourd.recording.synth.board_videos import BoardSettings, make_board_videos
from tests.faults.chain import COMMANDS, Runner, contents, leftovers, write_source

PAIRS = 4
"""Number of times that two calls of each command run at the same time."""
MAX_DELAY = 1.5
"""Maximum time in seconds between the starts of the two calls."""
DEADLINE = 900
"""Time in seconds after which a test counts as hanging."""
HEADLESS = ("--renderer", "cpu", "--size", "64", "48")
CALIBRATE = ("calibrate", "videos", "--board", "videos/board.toml", "-o", "calibration")
"""The names of files are relative to the working folder of the test."""
VIEWS = (
    ("view", "out/scene.4dv", *HEADLESS, "--headless", "out/scene.mp4", "--steps", "2"),
    ("view", "out/scene.4dv", *HEADLESS, "--screenshot", "out/scene.png"),
    ("view", "run", *HEADLESS, "--headless", "out/run.mp4", "--steps", "2"),
    ("view", "run", *HEADLESS, "--screenshot", "out/run.png"),
)
ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "FOURD_THREADS": "1",
    "COLUMNS": "1000",
}
BENCH = ("bench", "--quick", "--json", "out/bench.json", "--markdown", "out/bench.md")


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run, a scene, and videos of a board."""
    folder = tmp_path_factory.mktemp("pairs").resolve()
    root = folder / "work"
    write_source(root)
    runner = Runner(folder)
    for command in COMMANDS:
        outcome = runner.run(command, root)
        assert outcome.code == 0, outcome.text
    make_board_videos(root / "videos", BoardSettings(frames=24, cameras=3, size=400), untracked)
    return root


@pytest.fixture
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder for temporary files of the commands."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    return folder


def temporary(scratch: Path) -> list[str]:
    """The temporary files of fourd. torch has a cache in the same folder."""
    return [path.name for path in scratch.iterdir() if not path.name.startswith("torchinductor")]


def start(words: tuple[str, ...], root: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "fourd.cli.main", *words],
        cwd=root,
        env=os.environ | ENVIRONMENT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


def run_one(words: tuple[str, ...], root: Path) -> tuple[int, str]:
    """The exit code and the error output of a command."""
    process = start(words, root)
    try:
        text = process.communicate(timeout=DEADLINE)[1]
    finally:
        process.kill()
    return process.returncode, text


def run_two(words: tuple[str, ...], root: Path, delay: float) -> list[int]:
    """The exit codes of two calls of a command. Each call must end with its result or with one line."""
    with ThreadPoolExecutor() as pool:
        first = pool.submit(run_one, words, root)
        time.sleep(delay)
        second = pool.submit(run_one, words, root)
        outcomes = [first.result(), second.result()]
    for code, text in outcomes:
        assert "Traceback" not in text, text
        lines = [line for line in text.splitlines() if line.startswith(f"fourd {words[0]}: ")]
        assert (code, len(lines)) in ((0, 0), (2, 1)), text
    return [code for code, _ in outcomes]


@pytest.mark.slow
def test_two_calibrations_at_once(root: Path, scratch: Path, rng: np.random.Generator) -> None:
    """Catches a calibration that is mixed from two calls, and a second call that waits or ends with a traceback."""
    assert run_one(CALIBRATE, root)[0] == 0
    expected, names = numbers_in(root / "calibration"), sorted(contents(root))
    for _ in range(PAIRS):
        codes = run_two(CALIBRATE, root, float(rng.uniform(0, MAX_DELAY)))
        assert 0 in codes
        assert sorted(contents(root)) == names
        # Two calibrations of the same videos can differ in their last bits.
        np.testing.assert_allclose(numbers_in(root / "calibration"), expected, rtol=1e-6, atol=1e-9)
        assert leftovers(root) == []
    assert temporary(scratch) == []


def numbers_in(calibration: Path) -> list[float]:
    """All numbers in the files of a calibration that other programs read."""
    text = (calibration / "intri.yml").read_text() + (calibration / "extri.yml").read_text()
    return [float(number) for number in re.findall(r"-?\d+\.?\d*(?:e[-+]?\d+)?", text)]


@pytest.mark.slow
@pytest.mark.parametrize("words", VIEWS, ids=lambda words: f"{words[1]} {words[-1]}")
def test_two_views_at_once(words: tuple[str, ...], root: Path, scratch: Path, rng: np.random.Generator) -> None:
    """Catches pictures of one call that show files of the other call, and scratch folders that the calls share."""
    assert run_one(words, root)[0] == 0
    expected = contents(root)
    for _ in range(PAIRS):
        assert run_two(words, root, float(rng.uniform(0, MAX_DELAY))) == [0, 0]
        assert contents(root) == expected
        assert leftovers(root) == []
    assert temporary(scratch) == []


@pytest.mark.slow
def test_two_benchmarks_at_once(root: Path, scratch: Path, rng: np.random.Generator) -> None:
    """Catches a report that is mixed from two calls."""
    assert run_two(BENCH, root, float(rng.uniform(0, MAX_DELAY))) == [0, 0]
    check_report(root / "out")
    assert leftovers(root) == []
    assert temporary(scratch) == []


def check_report(folder: Path) -> None:
    """Check that the files of fourd bench are complete."""
    rows = json.loads((folder / "bench.json").read_text())["rows"]
    lines = (folder / "bench.md").read_text().splitlines()
    assert len(rows) > 10
    assert len(lines) == len(rows) + 4  # the machine, an empty line and the head of the table


@contextmanager
def serving(source: str, root: Path) -> Iterator[str]:
    """Serve a scene or a run. Yields the URL, and ends the command with Ctrl-C."""
    process = start(("serve", source, "--port", "0", "--no-browser"), root)
    try:
        assert process.stderr is not None
        url = None
        while url is None and (line := process.stderr.readline()):
            url = re.match(r"(http://[^ ]+?): ", line)
        assert url is not None, process.wait()
        yield url[1]
        process.send_signal(signal.SIGINT)
        text = process.communicate(timeout=DEADLINE)[1]
        assert (process.returncode, "Traceback" in text) == (0, False), text
    finally:
        process.kill()
        process.communicate()


def fetch(url: str) -> bytes:
    """Wait until the server has the file at ``url``, and return its content."""
    deadline = time.monotonic() + DEADLINE
    while True:
        try:
            with urllib.request.urlopen(url, timeout=DEADLINE) as answer:
                return answer.read()
        except urllib.error.HTTPError as error:
            if error.code != 404 or time.monotonic() > deadline:
                raise
        time.sleep(0.1)


@pytest.mark.slow
@pytest.mark.parametrize("source", ["out/scene.4dv", "run"])
def test_two_servers_at_once(source: str, root: Path, scratch: Path) -> None:
    """Catches servers that write into one folder, a server that ends with the other one, and leftover folders."""
    before = contents(root)
    with ExitStack() as second:
        with serving(source, root) as url:
            other = second.enter_context(serving(source, root))
            assert url != other
            scenes = [fetch_scene(each, source) for each in (url, other)]
            assert scenes[0] == scenes[1]
            assert len(temporary(scratch)) == 2
        assert fetch_scene(other, source) == scenes[0]
        assert len(temporary(scratch)) == 1
    assert contents(root) == before
    assert temporary(scratch) == []


def fetch_scene(url: str, source: str) -> bytes:
    """The scene that a server shows. A run is baked only after a page has requested its state."""
    deadline = time.monotonic() + DEADLINE
    while source == "run" and json.loads(fetch(f"{url}run/scene.json"))["state"] != "ready":
        assert time.monotonic() < deadline
        time.sleep(0.1)
    return fetch(f"{url}scene.4dv")
