"""Fuzz the kernel functions that Python can call, with libFuzzer, AddressSanitizer and UndefinedBehaviorSanitizer. With
--threads, three concurrent Python threads call the functions under ThreadSanitizer, with the inputs that are stored in
csrc/fuzz/corpus.txt.

    python tools/security/fuzz_kernels.py --seconds 60

    python tools/security/fuzz_kernels.py --seconds 3600 --keep

    python tools/security/fuzz_kernels.py --threads

libFuzzer is a part of Clang (apt-get install clang). The first call builds csrc/fuzz, which takes some minutes. The
corpus is in build/fuzz/kernels/ and grows with each run. An input that makes a function crash, hang or use 2 GB of
memory is written to the file build/fuzz/kernels-KIND-HASH. To repeat the failure, call build/fuzz-native/bindings with
this file.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from fourd.base.files import write_text_atomically

ROOT = Path(__file__).resolve().parents[2]
STORED = ROOT / "csrc" / "fuzz" / "corpus.txt"
"""A small corpus with the same code coverage as all inputs found so far. Each line is one input in hexadecimal
digits."""
FOLDER = ROOT / "build" / "fuzz"
COMPILERS = ("clang++", *(f"clang++-{version}" for version in range(24, 13, -1)))
MAX_BYTES = 512
"""Maximum size in bytes of an input."""
OPTIONS = (f"-max_len={MAX_BYTES}", "-timeout=30", "-rss_limit_mb=2048", "-detect_leaks=0", "-print_final_stats=1")
"""Options of libFuzzer. Leaks are not reported, because Python keeps memory until the process ends."""


@dataclass(frozen=True)
class Arguments:
    """Build the fuzzer and run it."""

    seconds: int = 60
    """Fuzzing time in seconds, without the time of the build."""
    keep: bool = False
    """After fuzzing, replace csrc/fuzz/corpus.txt by a small corpus with the same code coverage as all inputs of this
    run."""
    threads: bool = False
    """Call the functions from three concurrent threads. Only the stored inputs are used, because libFuzzer needs
    coverage counters to find new ones, and ThreadSanitizer would report these counters as data races."""
    optional: bool = False
    """If Clang is not installed, print a note instead of failing."""


def main(arguments: Arguments) -> int:
    """Build the fuzzer and run it. Return the exit code, which is 0 if no input failed."""
    compiler = next((found for name in COMPILERS if (found := shutil.which(name))), None)
    if compiler is None:
        print("fuzz_kernels: expected clang++, got none, so no kernel was fuzzed; install clang", file=sys.stderr)
        return 0 if arguments.optional else 2
    corpus = FOLDER / "kernels"
    corpus.mkdir(parents=True, exist_ok=True)
    stored = [corpus / f"stored-{number:05d}" for number in range(len(read_corpus(STORED)))]
    for path, content in zip(stored, read_corpus(STORED), strict=True):
        path.write_bytes(content)
    if arguments.threads:
        program = build(compiler, ROOT / "build" / "fuzz-threads", "thread")
        return 2 if fuzz(program, [str(path) for path in stored]) else 0
    program = build(compiler, ROOT / "build" / "fuzz-native", "address,undefined,fuzzer-no-link")
    code = fuzz(
        program, [f"-max_total_time={arguments.seconds}", f"-artifact_prefix={FOLDER / 'kernels'}-", str(corpus)]
    )
    if code == 0 and arguments.keep:
        smallest = FOLDER / "kernels-merged"
        shutil.rmtree(smallest, ignore_errors=True)
        smallest.mkdir()
        code = fuzz(program, ["-set_cover_merge=1", str(smallest), str(corpus)])
        write_corpus(STORED, [path.read_bytes() for path in smallest.iterdir()])
    return 2 if code else 0


def build(compiler: str, folder: Path, sanitizers: str) -> Path:
    """Build the program `bindings` with sanitizers and return its path."""
    nanobind = subprocess.run(
        [sys.executable, "-m", "nanobind", "--cmake_dir"], check=True, capture_output=True, text=True
    ).stdout.strip()
    cmake = shutil.which("cmake", path=str(Path(sys.executable).parent)) or "cmake"
    options = [
        f"-DCMAKE_CXX_COMPILER={compiler}",
        f"-DFOURD_SANITIZE={sanitizers}",
        f"-DPython_EXECUTABLE={sys.executable}",
        f"-Dnanobind_DIR={nanobind}",
    ]
    source = str(ROOT / "csrc" / "fuzz")
    subprocess.run([cmake, "-S", source, "-B", str(folder), "-G", "Unix Makefiles", *options], check=True)
    subprocess.run([cmake, "--build", str(folder), "--parallel", "2"], check=True)
    return folder / "bindings"


def fuzz(program: Path, words: Sequence[str]) -> int:
    environment = os.environ | {"ASAN_OPTIONS": "detect_leaks=0"}
    return subprocess.run([str(program), *OPTIONS, *words], check=False, env=environment).returncode


def read_corpus(path: Path) -> list[bytes]:
    """Read the inputs from a file with one input per line. Lines that start with # are comments."""
    lines = path.read_text().splitlines() if path.exists() else []
    return [bytes.fromhex(line) for line in lines if not line.startswith("#")]


def write_corpus(path: Path, inputs: Sequence[bytes]) -> None:
    lines = sorted((content.hex() for content in inputs), key=lambda line: (len(line), line))
    write_text_atomically(
        path, "# Inputs of csrc/fuzz, by tools/security/fuzz_kernels.py --keep\n" + "\n".join(lines) + "\n"
    )


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Arguments, description=__doc__)))
