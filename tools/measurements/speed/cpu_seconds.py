"""Run a fourd command on one thread. The command's time limits then apply to CPU time instead of elapsed time.

This makes the results almost independent of other programs on the machine.

python tools/measurements/speed/cpu_seconds.py fit-triangles CAPTURE -o mesh.ply --max-seconds 45
"""

from __future__ import annotations

import os
import sys
import time


def main() -> int:
    if len(sys.argv) < 2:
        print(__doc__, end="")
        return 2
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "FOURD_THREADS"):
        os.environ[name] = "1"
    # The clock must be replaced before fourd is imported, because fourd's modules import ``monotonic`` by name.
    time.monotonic = time.process_time
    from fourd.cli.main import main as run

    code = run(sys.argv[1:])
    print(f"{time.process_time():.1f} CPU seconds", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
