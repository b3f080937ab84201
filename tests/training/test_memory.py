"""What a process keeps of what it freed."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import ctypes
from fourd.training.memory import HeapTrimmer, retain_freed_memory, resident_bytes

def use_and_free(library, mebibytes):
    blocks = [library.malloc(ctypes.c_size_t(2**20)) for _ in range(mebibytes)]
    for block in blocks:
        ctypes.memset(block, 1, 2**20)
    for block in blocks[:-1]:  # the last one holds the top of the heap, so that it cannot simply shrink
        library.free(ctypes.c_void_p(block))

library = ctypes.CDLL(None)
library.malloc.restype = ctypes.c_void_p
retain_freed_memory()
before = resident_bytes()
trimmer = HeapTrimmer(before + 64 * 2**20, min_growth=0)
use_and_free(library, 32)
trimmer.after_step()
kept = resident_bytes() - before
use_and_free(library, 96)
trimmer.after_step()
print(kept // 2**20, (resident_bytes() - before) // 2**20)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only the GNU C library's heap is trimmed")
def test_small_growth_is_kept_for_reuse_and_large_growth_given_back():
    """A trim at every step pays page faults for everything; none at all lets memory grow with the steps."""
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    kept, left = map(int, done.stdout.split())
    assert kept >= 28
    assert left <= 16
