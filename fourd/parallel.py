"""A process pool that yields results as they come and leaves no process behind."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing.connection import wait as wait_for
from multiprocessing.queues import SimpleQueue
from typing import Any, TypeVar

import cv2

Job = TypeVar("Job")
Result = TypeVar("Result")
Item = TypeVar("Item")

MAX_BLOCK = 16
"""Items per job: few, so that all cores finish together; many, since each job opens its files again."""
POLL_SECONDS = 0.2


def core_count() -> int:
    """Number of cores available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def split_into_blocks(items: Sequence[Item], workers: int) -> list[Sequence[Item]]:
    """Blocks of consecutive items, several per worker."""
    length = max(1, min(MAX_BLOCK, len(items) // (3 * workers)))
    return [items[start : start + length] for start in range(0, len(items), length)]


def run_jobs(work: Callable[[Job], Iterable[Result]], jobs: Sequence[Job], workers: int) -> Iterator[Result]:
    """Yield the results of ``work`` for all jobs in the order of completion; in this process for one worker or job.

    When the consumer stops or a job fails, the processes are terminated; they also end when this process is killed.
    Jobs must therefore write files atomically.
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
"""In a process of the pool: the queue of its results."""


def _initialize(results: SimpleQueue[Any]) -> None:
    """Set up a process of the pool.

    It ignores Ctrl-C, which reaches all processes of a terminal and which the parent handles, ends with its parent,
    and uses one OpenCV thread, since the other cores run other processes.
    """
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
    """Defer Ctrl-C until the end of the block; processes started in it inherit the blocked signal."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
