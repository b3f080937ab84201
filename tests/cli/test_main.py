"""The environment that the entry point sets before it runs a command."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

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


@pytest.mark.parametrize("words", [["--help"], ["calibrate", "--help"]])
@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_reader_that_ends_first_is_no_error(words: list[str], unbuffered: str) -> None:
    """Catches ``fourd COMMAND --help | head`` that ends with the traceback of a BrokenPipeError."""
    read, write = os.pipe()
    os.close(read)
    program = "import sys; from fourd.cli.main import main; sys.exit(main(sys.argv[1:]))"
    try:
        done = subprocess.run(
            [sys.executable, "-c", program, *words],
            env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
            stdout=write,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    finally:
        os.close(write)
    assert done.stderr == ""
    assert done.returncode == 141
