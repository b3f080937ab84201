"""What the entry point does before any command."""

from __future__ import annotations

import os
import subprocess
import sys

PROGRAM = """
import os, sys
from fourd.cli.main import main
assert "torch" not in sys.modules, "torch was loaded before its threads were told"
main(["--version"])
print(os.environ["GOMP_SPINCOUNT"])
"""


def spins(**set_before: str) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "GOMP_SPINCOUNT"}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env={**environment, **set_before}, capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()[-1]


def test_torch_s_threads_are_told_not_to_spin_before_it_is_loaded() -> None:
    """Catches a setting that comes after torch, when nobody reads it, or one that overrules the user's."""
    assert spins() == "20000"
    assert spins(GOMP_SPINCOUNT="5") == "5"
