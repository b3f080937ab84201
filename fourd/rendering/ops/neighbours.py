"""Multithreaded nearest-neighbour search that Ctrl-C stops cleanly, without leaving threads running."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from fourd.rendering.ops.loading import thread_count

BLOCK = 4096
"""Number of queried positions per search. On Ctrl-C, running searches finish, and those that have not started are
cancelled."""


def nearest_neighbours(
    points: NDArray[np.floating], queried: NDArray[np.floating], count: int, *, threads: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Find the nearest points of each queried position.

    The function does not use the argument ``workers`` of scipy's tree, because after Ctrl-C, scipy's threads would
    continue to read arrays that Python has already freed.

    Args:
        points: (N, 3) positions.
        queried: (Q, 3) positions in the same units.
        count: number of points to find for each position, at least 1.
        threads: number of threads; 0 means the environment variable FOURD_THREADS, or all cores if it is not set.

    Returns:
        distances and indices of the points, nearest first, each (Q, count), or (Q,) if ``count`` is 1. If there are
        fewer than ``count`` points, missing distances are infinite and missing indices are N.
    """
    tree = cKDTree(points)
    blocks = [queried[start : start + BLOCK] for start in range(0, max(len(queried), 1), BLOCK)]
    with ThreadPoolExecutor(thread_count(threads)) as pool:
        searches = [pool.submit(tree.query, block, k=count) for block in blocks]
        try:
            found: list[tuple[Any, Any]] = [search.result() for search in searches]
        except BaseException:
            for search in searches:
                search.cancel()
            raise
    return np.concatenate([part[0] for part in found]), np.concatenate([part[1] for part in found])
