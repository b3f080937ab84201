"""The environment variables that torchrun sets in the processes that it starts. These processes are called ranks."""

from __future__ import annotations

import os


def rank_count() -> int:
    """Return the number of ranks on all machines together, or 1 if torchrun did not start this process."""
    return int(os.environ.get("WORLD_SIZE", "1"))


def local_rank() -> int:
    """Return the index of this rank among the ranks on the same machine, from 0."""
    return int(os.environ.get("LOCAL_RANK", "0"))
