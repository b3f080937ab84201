"""Work in several processes or threads. The process pool yields each result as soon as it is ready, and leaves no
process running after an error."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing.connection import wait as wait_for
from multiprocessing.queues import SimpleQueue
from typing import Any, TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")
Item = TypeVar("Item")

MAX_BLOCK = 16
"""Maximum number of items per job: small enough that all cores finish at about the same time, and large enough that
input files, which each job opens again, are not opened too often."""
POLL_SECONDS = 0.2
"""Interval in seconds at which the queue of results is read."""


def core_count() -> int:
    """Return the number of cores available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def split_into_blocks(items: Sequence[Item], workers: int) -> list[Sequence[Item]]:
    """Split items into blocks of consecutive items, with several blocks per worker."""
    length = max(1, min(MAX_BLOCK, len(items) // (3 * workers)))
    return [items[start : start + length] for start in range(0, len(items), length)]


def map_threads(work: Callable[[Item], Result], items: Iterable[Item], workers: int) -> list[Result]:
    """Return the results of ``work`` for all items, in their order, computed by at most ``workers`` threads. It pays if
    ``work`` spends its time in NumPy and OpenCV, which run without the interpreter's lock."""
    if workers == 1:
        return [work(item) for item in items]
    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(work, items))


def run_jobs(work: Callable[[Job], Iterable[Result]], jobs: Sequence[Job], workers: int) -> Iterator[Result]:
    """Yield the results of ``work`` for all jobs, each as soon as it is ready. A job can have several results.

    If there is only one worker or one job, ``work`` runs in this process, without a pool. The pool's processes are
    terminated when the caller stops the iteration or a job fails, and exit when their parent process is killed. Because
    a job can be terminated at any time, jobs must write files atomically.
    """
    if workers == 1 or len(jobs) == 1:
        for job in jobs:
            yield from work(job)
        return
    context = multiprocessing.get_context("spawn")
    results: SimpleQueue[Any] = context.SimpleQueue()
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_initialize, initargs=(results,)) as pool:
        try:
            with _block_interrupts():
                pending: set[Future[None]] = {pool.submit(_run_job, work, job) for job in jobs}
            while pending:
                done, pending = wait(pending, timeout=POLL_SECONDS, return_when=FIRST_COMPLETED)
                while not results.empty():
                    yield results.get()
                for future in done:
                    future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()
            raise


_results: SimpleQueue[Any]
"""Queue of results, which exists only in the processes of the pool."""


def _initialize(results: SimpleQueue[Any]) -> None:
    """Set up a process of the pool.

    The process ignores Ctrl-C: the terminal sends it to all processes, and the parent process handles it for all. The
    process exits when its parent exits. OpenCV uses only one thread, because the other cores run the other processes of
    the pool.
    """
    import cv2  # Commands that start no processes must not wait for this import.

    global _results
    cv2.setNumThreads(1)
    _results = results
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait_for([parent.sentinel])
    os._exit(1)


def _run_job(work: Callable[[Job], Iterable[object]], job: Job) -> None:
    for result in work(job):
        _results.put(result)


@contextmanager
def _block_interrupts() -> Iterator[None]:
    """Defer Ctrl-C until the end of the ``with`` block.

    Processes that start inside the block inherit the blocked signal SIGINT.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
