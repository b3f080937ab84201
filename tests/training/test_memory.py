"""Return of freed memory to the operating system, measured by the resident size of a process."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROGRAM = """
import ctypes
from fourd.reconstruction.training.memory import HeapTrimmer, retain_freed_memory, resident_bytes

def use_and_free(library, mebibytes):
    blocks = [library.malloc(ctypes.c_size_t(2**20)) for _ in range(mebibytes)]
    for block in blocks:
        ctypes.memset(block, 1, 2**20)
    for block in blocks[:-1]:  # the last block stays at the top of the heap, so that the heap cannot shrink by itself
        library.free(ctypes.c_void_p(block))

library = ctypes.CDLL(None)
library.malloc.restype = ctypes.c_void_p
retain_freed_memory()
before = resident_bytes()
trimmer = HeapTrimmer(before + 64 * 2**20, min_growth=0)
use_and_free(library, 32)
trimmer.after_step()
retained = resident_bytes() - before
use_and_free(library, 96)
trimmer.after_step()
print(retained // 2**20, (resident_bytes() - before) // 2**20)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only the heap of the GNU C library is trimmed")
def test_small_growth_is_retained_and_large_growth_returned():
    """Catches freed memory that is returned in every step, which causes page faults, and memory that grows with the
    number of steps."""
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    retained, left = map(int, done.stdout.split())
    assert retained >= 28
    assert left <= 16
