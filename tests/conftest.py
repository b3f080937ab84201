"""Fixtures that all tests share. Every run has new random seeds. The seeds are printed, so that a run can be repeated
with the same seed.
"""

from __future__ import annotations

import gc
import importlib.util
import os
import secrets
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import torch

from fourd.rendering.ops.gpu import cuda_unavailable_reason
from tests.captures import write_ball_capture
from tests.processes.shared import shared_parsers

SEED = "FOURD_TEST_SEED"
LONG = ("viewer", "faults", "board_calibration", "pipeline", "cli", "training", "storage", "examples", "matting")
"""Folders whose files take up to a minute. They are tested first, so that the processes end at the same time."""


def pytest_configure() -> None:
    """If a shell has started the tests as a background job, this process ignores SIGINT. The commands that tests start
    would also ignore SIGINT, and tests that interrupt a command would wait until their time limits. This function
    therefore restores Python's handler of SIGINT.

    It also draws the seed of the run, unless FOURD_TEST_SEED is set. The worker processes inherit it. It is printed
    before the first test: a test that crashes its process prints nothing.
    """
    os.environ.setdefault(SEED, str(secrets.randbits(32)))
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items.sort(key=lambda item: _place(item.path))


def _place(file: Path) -> int:
    """Return the place of a file's folder in LONG. All other files come after them."""
    folder = file.relative_to(Path(__file__).parent).parts[0]
    return LONG.index(folder) if folder in LONG else len(LONG)


def pytest_collection_finish() -> None:
    """Exclude the modules and the collected tests, which live as long as the process, from garbage collections. Each of
    the many collections would visit these millions of objects again."""
    gc.collect()
    gc.freeze()


def pytest_report_header() -> str:
    return f"{SEED}={os.environ[SEED]}"


@pytest.fixture
def rng() -> np.random.Generator:
    """A random generator with the seed of this run. To use the same seed again, set the environment variable
    FOURD_TEST_SEED."""
    return np.random.default_rng(int(os.environ[SEED]))


@pytest.fixture(autouse=True)
def _process_stays_as_it_was() -> Iterator[None]:
    """A test that leaves gradients disabled fails here, because all later tests in its process that train would fail.

    Priorities are restored: commands that show a run lower the priority of their process, and SVT-AV1 gives the thread
    that encodes real-time priority if the process runs as root. Tests in the other processes would starve. The number
    of OpenMP threads is restored, too: the package spz sets it to the number of cores. The idle threads of all later
    tests would then use most of the processor's time.
    """
    threads = torch.get_num_threads()
    niceness = os.getpriority(os.PRIO_PROCESS, 0) if hasattr(os, "getpriority") else 0
    yield
    torch.set_num_threads(threads)
    if hasattr(os, "sched_getscheduler"):
        if os.sched_getscheduler(0) != os.SCHED_OTHER:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        with suppress(PermissionError):
            os.setpriority(os.PRIO_PROCESS, 0, niceness)
    enabled = torch.is_grad_enabled()
    torch.set_grad_enabled(True)
    assert enabled, "this test has left torch's gradients disabled"


@pytest.fixture(scope="session", autouse=True)
def _nothing_waits_for_the_disk() -> Iterator[None]:
    """Files are not flushed to the disk in the processes that run tests: only a failure of the power, which no test
    causes, would show the difference, and some commands would wait for the disk most of their time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda descriptor: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def _parsers_are_shared() -> Iterator[None]:
    with shared_parsers():
        yield


@pytest.fixture(scope="session")
def ball_capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A capture of a striped ball: 8 cameras, 3 frames, 64 x 64. Tests must not change this capture."""
    return write_ball_capture(tmp_path_factory.mktemp("ball"), frames=3)


@pytest.fixture(params=["emulated", "cuda"])
def gpu(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> torch.device:
    """Device on which the CUDA kernels run: a GPU, or a CPU that emulates a GPU."""
    if request.param == "cuda":
        if not torch.cuda.is_available():
            pytest.skip("no CUDA device here")
        if cuda_unavailable_reason():
            pytest.skip("the CUDA kernels are not built")
        return torch.device("cuda", torch.cuda.current_device())
    if importlib.util.find_spec("fourd._emulated") is None:
        pytest.skip("the emulated kernels are not built")
    monkeypatch.setenv("FOURD_SIMD", "emulated")
    return torch.device("cpu")
