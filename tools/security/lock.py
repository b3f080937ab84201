"""Write requirements.lock: all packages that `make` installs, except torch, with the hashes of all their files.

    .venv/bin/python tools/security/lock.py [UV]

Run this program after the dependencies in pyproject.toml or constraints.txt have changed. UV is the path of the program
uv (https://docs.astral.sh/uv), which is searched on PATH by default. torch is left out, because its CPU and CUDA builds
are different files with the same version number. The CUDA packages are left out, because only the CUDA builds of torch
need them.
"""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
LOCK = "requirements.lock"
PYTHON = "3.11"
"""The oldest Python version that pyproject.toml allows."""
EXTRAS = ("train", "viewer", "splats", "cluster", "storage", "onnx", "notebook")
GROUPS = ("dev", "docs")
"""The extras and dependency groups that `make` installs."""
BUILD = ("cmake", "ninja", "scikit-build-core", "nanobind")
"""Packages that are needed to build the kernels. `make` installs them in the same environment as fourd."""
OF_TORCH = ("torch", "triton", "cuda-", "nvidia-")
"""Packages that are left out of the lock file. A string that ends with a hyphen is a prefix of package names; any other
string is a whole name."""
HEADER = """\
# All packages that `make` installs, except torch and the packages of CUDA, for all platforms and versions of Python.
# tools/security/lock.py writes this file. pip installs only files with one of these hashes (--require-hashes).
"""


def main() -> int:
    uv = sys.argv[1] if len(sys.argv) > 1 else "uv"
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    project = settings["project"]
    wanted = [*project["dependencies"], *BUILD]
    wanted += [each for extra in EXTRAS for each in project["optional-dependencies"][extra]]
    wanted += [each for group in GROUPS for each in settings["dependency-groups"][group]]
    words = [uv, "pip", "compile", "-", "--universal", "--python-version", PYTHON, "-c", "constraints.txt"]
    words += ["--generate-hashes", "--no-header", "--no-annotate", "--quiet"]
    result = subprocess.run(words, input="\n".join(wanted), cwd=ROOT, check=True, capture_output=True, text=True)
    (ROOT / LOCK).write_text(HEADER + without_torch(result.stdout))
    return 0


def without_torch(text: str) -> str:
    """Return the lock file's text without torch and the CUDA packages. Each package is one line, followed by indented
    lines with hashes."""
    kept, is_kept = [], True
    for line in text.splitlines(keepends=True):
        if not line.startswith(" "):
            is_kept = not line.startswith(tuple(name if name.endswith("-") else f"{name}==" for name in OF_TORCH))
        kept += [line] * is_kept
    return "".join(kept)


if __name__ == "__main__":
    sys.exit(main())
