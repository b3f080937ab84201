"""Run a command and record the memory of its process tree over time (Linux only).

    python tools/measurements/speed/tree_memory.py memory.csv -- fourd matte CAPTURE

The program writes one CSV line every ``--every`` seconds: the seconds since the start, the number of processes, and
their total memory in MB. Memory is the proportional set size (PSS), which counts shared memory once. At the end, the
program prints the maximum memory, and the mean memory in each tenth of the running time, to stderr.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

TENTHS = 10


def main() -> int:
    """Run the command and return its exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", type=Path, help="CSV file to write")
    parser.add_argument("--every", type=float, default=1.0, help="seconds between samples (default 1)")
    parser.add_argument("command", nargs="+", help="the command, after --")
    arguments = parser.parse_args()
    started = time.monotonic()
    rows: list[float] = []
    process = subprocess.Popen(arguments.command)
    with arguments.table.open("w", encoding="utf-8", buffering=1) as table:
        table.write("seconds,processes,MB\n")
        while process.poll() is None:
            sizes_mb = [_pss_mb(each) for each in (process.pid, *_children(process.pid))]
            rows.append(sum(sizes_mb))
            table.write(f"{time.monotonic() - started:.1f},{len(sizes_mb)},{rows[-1]:.1f}\n")
            time.sleep(arguments.every)
    parts = [rows[len(rows) * part // TENTHS : len(rows) * (part + 1) // TENTHS] for part in range(TENTHS)]
    means = " ".join(f"{sum(part) / len(part):.0f}" for part in parts if part)
    seconds = time.monotonic() - started
    print(f"{seconds:.0f} s, at most {max(rows):.0f} MB; mean MB in each tenth of the time: {means}", file=sys.stderr)
    return process.returncode


def _children(pid: int) -> Iterator[int]:
    """Yield the ids of all descendants of a process."""
    try:
        found = [int(word) for path in Path(f"/proc/{pid}/task").iterdir() for word in _words(path / "children")]
    except OSError:
        return
    for child in found:
        yield child
        yield from _children(child)


def _pss_mb(pid: int) -> float:
    """Return the proportional set size of a process in MB, or 0 if the process has ended."""
    words = _words(Path(f"/proc/{pid}/smaps_rollup"))
    return int(words[words.index("Pss:") + 1]) / 1024 if "Pss:" in words else 0.0


def _words(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="ascii").split()
    except OSError:
        return []


if __name__ == "__main__":
    sys.exit(main())
