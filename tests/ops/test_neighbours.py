"""Nearest neighbours of points."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fourd.rendering.ops.neighbours import BLOCK, nearest_neighbours

SEARCH = """
import gc, sys
import numpy as np
from fourd.rendering.ops.neighbours import nearest_neighbours

def search():
    points = np.random.default_rng(0).random((60000, 3))
    print("ready", flush=True)
    while True:
        nearest_neighbours(points, points, 24)

try:
    search()
except KeyboardInterrupt:
    gc.collect()
    filler = [np.full(60000, np.nan) for _ in range(40)]
    print("interrupted", flush=True)
"""


@pytest.mark.parametrize("count", [1, 5])
@pytest.mark.parametrize("queried", [0, 1, BLOCK + 3])
def test_neighbours_equal_those_of_one_search(count: int, queried: int, rng: np.random.Generator) -> None:
    """Catches blocks in the wrong order, and shapes that differ from those of scipy."""
    points, positions = rng.random((500, 3)), rng.random((queried, 3))
    expected = cKDTree(points).query(positions, k=count)
    for found, wanted in zip(nearest_neighbours(points, positions, count), expected, strict=True):
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("delay", [0.02, 0.1])
def test_interrupted_searches_leave_no_thread_behind(delay: float, tmp_path: Path) -> None:
    """Catches threads that read freed arrays after Ctrl-C, which ended `fourd make` with a segmentation fault."""
    search = subprocess.Popen([sys.executable, "-c", SEARCH], stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    try:
        assert search.stdout is not None
        assert search.stdout.readline() == "ready\n"
        time.sleep(delay)
        search.send_signal(signal.SIGINT)
        assert search.communicate(timeout=60)[0] == "interrupted\n"
        assert search.returncode == 0
    finally:
        search.kill()  # A search that is not interrupted would run without end.
