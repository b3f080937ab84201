"""Work spread over processes, which end when the user stops and start nothing that was done."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")
Item = TypeVar("Item")

LONGEST_BLOCK = 16
"""Items of a job: few, so that cores end together; many, since each job opens its files again."""


def blocks(items: Sequence[Item], workers: int) -> list[Sequence[Item]]:
    """Runs of neighbouring items, some for each worker."""
    length = max(1, min(LONGEST_BLOCK, len(items) // (3 * workers)))
    return [items[begin : begin + length] for begin in range(0, len(items), length)]


def spread(work: Callable[[Job], Result], jobs: Sequence[Job], workers: int) -> Iterator[Result]:
    """Results of ``work`` on the jobs as they end, in any order; in this process where ``workers`` is 1.

    When the consumer stops or a job fails, the processes are ended: files must be written atomically.
    """
    if workers == 1 or len(jobs) == 1:
        yield from map(work, jobs)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, mp_context=context, initializer=_ignore_interrupts) as pool:
        futures = [pool.submit(work, job) for job in jobs]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.terminate()
            raise


def _ignore_interrupts() -> None:
    """Ctrl-C reaches all processes of a terminal; the parent alone answers it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
