"""The environment that the entry point sets before it runs a command."""

from __future__ import annotations

import os
import subprocess
import sys

PROGRAM = """
import os, sys
from fourd.cli.main import main
assert "torch" not in sys.modules, "torch was imported before GOMP_SPINCOUNT was set"
main(["--version"])
print(os.environ["GOMP_SPINCOUNT"])
"""


def spin_count(**set_before: str) -> str:
    environment = {name: value for name, value in os.environ.items() if name != "GOMP_SPINCOUNT"}
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], env={**environment, **set_before}, capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()[-1]


def test_spin_count_is_set_before_torch_is_imported() -> None:
    """Catches GOMP_SPINCOUNT that is set after torch is imported, and a default that overrides the user's value."""
    assert spin_count() == "20000"
    assert spin_count(GOMP_SPINCOUNT="5") == "5"
