"""Compute digests of fourd's results, to check that a code change leaves every bit of the results unchanged.

    python tools/same_bits.py --fourd OLD/.venv/bin/fourd --json before.json

    python tools/same_bits.py --fourd .venv/bin/fourd --compare before.json

The program runs the commands of one installation on synthetic captures in a temporary folder. First, it makes mattes,
clean plates (images of the empty scene) and visual hulls. Then it trains, exports, renders and evaluates an object
scene (only the foreground), a full scene (with the background) and a scene with camera refinement. Finally, it runs
`fourd make`. The whole program takes about six minutes on two cores. Compare only digests from the same machine,
because the bits depend on the CPU's instruction set.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

CLOCKS = ("seconds",)
"""Keys of a checkpoint's state whose values are times. They are left out of the digest, because times differ between
any two runs."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fourd", type=Path, required=True, help="the fourd program of the installation to run")
    parser.add_argument("--json", type=Path, help="write the digests to this JSON file")
    parser.add_argument("--compare", type=Path, help="exit with code 1 if a digest differs from this JSON file")
    parser.add_argument("--keep", type=Path, help="write all results to this folder, and do not delete it")
    arguments = parser.parse_args()
    program = arguments.fourd.absolute()
    if arguments.keep is None:
        with tempfile.TemporaryDirectory() as folder:
            digests = run_everything(program, Path(folder))
    else:
        arguments.keep.mkdir(parents=True, exist_ok=True)
        digests = run_everything(program, arguments.keep)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(digests, indent=1) + "\n")
    if arguments.compare is None:
        return 0
    return compare(json.loads(arguments.compare.read_text()), digests)


def compare(before: dict[str, str], after: dict[str, str]) -> int:
    """Print every file whose digests in ``before`` and ``after`` differ, and every file that one of them lacks.

    Returns 1 if there is such a file, and 0 otherwise.
    """
    names = sorted(before.keys() | after.keys())
    different = [name for name in names if before.get(name) != after.get(name)]
    for name in different:
        print(f"{name}: {before.get(name, 'absent')} before, {after.get(name, 'absent')} after")
    print(f"{len(names) - len(different)} of {len(names)} files have the same bits")
    return 1 if different else 0


def run_everything(program: Path, folder: Path) -> dict[str, str]:
    """Run every stage. Return a mapping from the path of each result file, relative to ``folder``, to its digest."""

    def fourd(*words: str) -> None:
        print("fourd", *words, flush=True)
        subprocess.run([program, *words], cwd=folder, check=True, stdout=subprocess.DEVNULL)

    steps = ("--max-steps", "40", "--points", "3000", "--test-views", "03")
    fourd("synth", "capture", "--frames", "3", "--cameras", "8", "--size", "160")
    unmatted = folder / "unmatted"
    shutil.copytree(folder / "capture", unmatted, ignore=shutil.ignore_patterns("masks", "truth", "bgs", ".fourd"))
    fourd("matte", "unmatted")
    fourd("carve", "capture", "-o", "hulls", "--points", "3000")
    fourd("train", "capture", "-o", "object", *steps)
    fourd("train", "capture", "-o", "whole", "--scene", "full", "--background-points", "4000", *steps)
    fourd("train", "capture", "-o", "refined", "--refine-cameras", "--refine-colours", *steps)
    for name in ("object", "whole", "refined"):
        fourd("eval", name, "--json", f"{name}.json")
        fourd("export", name, "-o", f"{name}.4dv")
        fourd("render", name, "--views", "03", "--out", f"{name}-run")
        fourd("render", f"{name}.4dv", "--views", "03", "--out", f"{name}-scene")
    fourd("make", "unmatted", "-o", "made.4dv", "--scene", "full", *steps)
    return digests_of(folder)


def digests_of(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every result file: images, points, checkpoints, scenes and scores."""
    patterns = (
        "capture/**/*.jpg",
        "capture/**/*.png",
        "unmatted/.fourd/**/*.png",
        "hulls/**/*.ply",
        "*/hull/*.ply",
        "*/background/*.ply",
        "*/checkpoints/**/*.safetensors",
        "*.4dv",
        "*.json",
        "*-run/**/*.png",
        "*-scene/**/*.png",
    )
    paths = {path for pattern in patterns for path in folder.glob(pattern) if path.is_file()}
    return {str(path.relative_to(folder)): digest(path) for path in sorted(paths)}


def digest(path: Path) -> str:
    content = path.read_bytes()
    if path.suffix == ".safetensors":
        content = without_clocks(content)
    return hashlib.sha256(content).hexdigest()


def without_clocks(content: bytes) -> bytes:
    """Return the bytes of a safetensors file without the times in its header."""
    (length,) = struct.unpack("<Q", content[:8])
    header = json.loads(content[8 : 8 + length])
    metadata = header.get("__metadata__") or {}
    if "state" in metadata:
        state = json.loads(metadata["state"])
        metadata["state"] = json.dumps({name: value for name, value in state.items() if name not in CLOCKS})
        # This digest of the whole checkpoint depends on the times.
        metadata.pop("digest", None)
    return json.dumps(header, sort_keys=True).encode() + content[8 + length :]


if __name__ == "__main__":
    sys.exit(main())
