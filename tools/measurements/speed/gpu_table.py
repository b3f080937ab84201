"""Print the benchmark table of this machine's CUDA device.

The script tools/gpu_check.sh runs this program, which needs only the packages torch and rich.
"""

from __future__ import annotations

import sys

from rich.console import Console

from fourd.benchmarks.gpu_cases import gpu_cases
from fourd.benchmarks.machine import this_machine
from fourd.benchmarks.report import Row, markdown
from fourd.benchmarks.timing import Clock
from fourd.rendering.ops.gpu import has_gpu


def main() -> int:
    """Print the table as Markdown to standard output."""
    if not has_gpu():
        print("gpu_table: expected a CUDA device and kernels built for it, got none", file=sys.stderr)
        return 2
    clock, console = Clock(seconds=3.0), Console(stderr=True)
    rows = []
    for case in gpu_cases():
        console.print(case.name, soft_wrap=True)
        rows.append(Row.measure(case, clock, rivals=True))
    print(markdown(rows, this_machine()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
