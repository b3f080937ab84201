"""Count the kernels' instructions with valgrind, and compare the counts with tools/instructions.json.

    python tools/count_instructions.py

    python tools/count_instructions.py --update

Without --update, the program fails if a count is more than 5% above the accepted count. With --update, the current
counts become the accepted counts. Unlike times, instruction counts do not depend on the load of the machine. They do
depend on the compiler, so nothing is compared if there are no accepted counts for the compiler in use. The AVX2 kernels
are counted, because valgrind does not support AVX-512.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from fourd.base.files import write_text_atomically

ROOT = Path(__file__).resolve().parents[1]
ACCEPTED = ROOT / "tools" / "instructions.json"
MAX_RATIO = 1.05
WORKLOADS = {
    "render": "render 8192 256 256 15",
    "render backward": "backward 8192 256 256 15",
    "play": "play 16384 480 270 12",
    "planes": "planes 8192 1 1 1",
    "planes backward": "planes_backward 8192 1 1 1",
    "hash grid": "hashgrid 8192 1 1 12",
    "hash grid backward": "hashgrid_backward 8192 1 1 12",
    "sources": "sources 8192 256 256 1",
    "sources backward": "sources_backward 8192 256 256 1",
    "similarity": "similarity 1 128 128 1",
    "heads": "heads 2048 1 1 1",
    "heads backward": "heads_backward 2048 1 1 1",
    "encoder": "encoder 1 128 64 1",
    "encoder backward": "encoder_backward 1 128 64 1",
    "moves": "moves 8192 1 1 1",
}


@dataclass(frozen=True)
class Arguments:
    """Compare the current instruction counts with the accepted counts, or accept the current counts."""

    update: bool = False
    """Store the current counts as the accepted counts, instead of comparing."""
    build: Path = ROOT / "build" / "count"
    """Folder in which the program `workload` is built. This program runs one kernel on test data."""


def main(arguments: Arguments) -> int:
    """Build the program, count the instructions of each entry of WORKLOADS and compare the counts. Return the exit
    code."""
    if shutil.which("valgrind") is None:
        print("count_instructions: expected valgrind, got none; install it (apt-get install valgrind)", file=sys.stderr)
        return 2
    compiler, program = build(arguments.build)
    counts = {name: count(program, words.split()) for name, words in WORKLOADS.items()}
    accepted = json.loads(ACCEPTED.read_text()) if ACCEPTED.exists() else {}
    if arguments.update:
        write_text_atomically(ACCEPTED, json.dumps({**accepted, compiler: counts}, indent=1, sort_keys=True) + "\n")
        print(f"{ACCEPTED}: {compiler}")
        return 0
    if compiler not in accepted:
        print(f"{compiler}: no accepted counts for this compiler; accepted compilers: {', '.join(accepted) or 'none'}")
    worse = 0
    for name, instructions in counts.items():
        before = accepted.get(compiler, {}).get(name)
        ratio = instructions / before if before else 1.0
        worse += ratio > MAX_RATIO
        print(
            f"{name:18} {instructions / 1e6:8.1f} M instructions  {ratio:.3f}"
            + ("  TOO MANY" if ratio > MAX_RATIO else "")
        )
    return 1 if worse else 0


def build(folder: Path) -> tuple[str, Path]:
    """Build the program ``workload``. Return the compiler's name and version, and the path of the program."""
    configure = ["cmake", "-S", str(ROOT / "csrc" / "tests"), "-B", str(folder), "-DCMAKE_BUILD_TYPE=Release"]
    run_quietly(configure)
    run_quietly(["cmake", "--build", str(folder), "--target", "workload", "--parallel"])
    cache = run_quietly(["cmake", "-LA", "-N", str(folder)])
    path = re.search(r"^CMAKE_CXX_COMPILER:\w+=(.*)$", cache, re.MULTILINE)
    version = run_quietly([path[1] if path else "c++", "--version"]).splitlines()[0]
    return version.split(" ", 1)[1], folder / "workload"


def count(program: Path, words: list[str]) -> int:
    """Return the number of instructions in one repetition of a workload. The workload is the kernel call that the
    arguments ``words`` describe. The program's setup is not counted."""
    once, thrice = (count_process([str(program), *words, str(repeats), "1", "avx2"]) for repeats in (1, 3))
    return (thrice - once) // 2


def count_process(command: list[str]) -> int:
    """Return the number of instructions that callgrind counts in one process."""
    tool = ["valgrind", "--tool=callgrind", "--callgrind-out-file=/dev/null", *command]
    output = subprocess.run(tool, capture_output=True, text=True, check=True).stderr
    found = re.search(r"Collected : (\d+)", output)
    if found is None:
        raise RuntimeError(f"valgrind: expected a line 'Collected', got: {output[-400:]}")
    return int(found[1])


def run_quietly(command: list[str]) -> str:
    """Run a command and return its output. If the command fails, raises RuntimeError with the error output."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: {done.stderr[-2000:]}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Arguments)))
