"""Runs Python code in a process in which some packages cannot be imported."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence

BLOCKED = """
import sys

class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {packages!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.meta_path.insert(0, Blocked())
"""
MAIN = """
from fourd.cli.main import main
sys.exit(main())
"""


def run_without(packages: Sequence[str], code: str, *words: str) -> subprocess.CompletedProcess[str]:
    """Run ``code`` with the arguments ``words``. Imports of ``packages`` fail as if they were not installed."""
    program = BLOCKED.format(packages=tuple(packages)) + code
    return subprocess.run([sys.executable, "-c", program, *words], capture_output=True, text=True, check=False)
