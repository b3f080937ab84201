"""Run a command of fourd on one thread, with time limits in CPU seconds of the command's process.

Such limits make the results almost independent of other programs on the machine.

python tools/cpu_seconds.py fit-triangles CAPTURE -o mesh.ply --max-seconds 45
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
    # The clock is replaced before fourd is imported, because fourd's modules import the function ``monotonic`` by name.
    time.monotonic = time.process_time
    from fourd.cli.main import main as run

    code = run(sys.argv[1:])
    print(f"{time.process_time():.1f} CPU seconds", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
