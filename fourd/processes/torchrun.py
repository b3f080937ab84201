"""Environment variables with which torchrun describes the processes that it starts. Each process is called a rank."""

from __future__ import annotations

import os


def rank_count() -> int:
    """Number of ranks on all machines together; 1 if torchrun did not start this process."""
    return int(os.environ.get("WORLD_SIZE", "1"))


def local_rank() -> int:
    """Number of this rank among the ranks on the same machine, from 0."""
    return int(os.environ.get("LOCAL_RANK", "0"))
