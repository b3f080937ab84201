"""Work spread over processes, which end when the user stops and start nothing that was done."""

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

LONGEST_BLOCK = 16
"""Items of a job: few, so that cores end together; many, since each job opens its files again."""
LOOK_SECONDS = 0.2
"""Between two looks for results."""


def core_count() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def split_into_blocks(items: Sequence[Item], workers: int) -> list[Sequence[Item]]:
    """Runs of neighbouring items, some for each worker."""
    length = max(1, min(LONGEST_BLOCK, len(items) // (3 * workers)))
    return [items[begin : begin + length] for begin in range(0, len(items), length)]


def run_jobs(work: Callable[[Job], Iterable[Result]], jobs: Sequence[Job], workers: int) -> Iterator[Result]:
    """Results of ``work`` on the jobs as they come, in any order; in this process where ``workers`` is 1.

    When the consumer stops or a job fails, the processes are ended, and they end by themselves when this one was
    killed: files must be written atomically.
    """
    if workers == 1 or len(jobs) == 1:
        for job in jobs:
            yield from work(job)
        return
    context = multiprocessing.get_context("spawn")
    results: SimpleQueue[Any] = context.SimpleQueue()
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_begin, initargs=(results,)) as pool:
        try:
            with _interrupts_held():
                pending: set[Future[None]] = {pool.submit(_do, work, job) for job in jobs}
            while pending:
                done, pending = wait(pending, timeout=LOOK_SECONDS, return_when=FIRST_COMPLETED)
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
"""Of a process of the pool: where its results go."""


def _begin(results: SimpleQueue[Any]) -> None:
    """Ctrl-C reaches all processes of a terminal, and the parent alone answers it; its death ends this process.

    OpenCV's threads would take the other processes' cores.
    """
    global _results
    cv2.setNumThreads(1)
    _results = results
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait_for([parent.sentinel])
    os._exit(1)


def _do(work: Callable[[Job], Iterable[object]], job: Job) -> None:
    for result in work(job):
        _results.put(result)


@contextmanager
def _interrupts_held() -> Iterator[None]:
    """Ctrl-C waits until the end of this; processes that are started meanwhile never hear it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
