"""The environment that the entry point sets before it runs a command."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from fourd.cli.main import SPIN_COUNT, main
from tests.baking.scenes import write_scene

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
    assert spin_count() == SPIN_COUNT
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


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="the test writes into the folder /proc of Linux")
@pytest.mark.parametrize(
    "words",
    [
        ("view", "SCENE", "--renderer", "cpu", "--size", "32", "24", "--screenshot", "/proc/self/mem"),
        ("view", "SCENE", "--renderer", "cpu", "--size", "32", "24", "--headless", "/proc/new.mp4", "--steps", "1"),
        ("render", "SCENE", "--path", "orbit", "--steps", "1", "--size", "32", "24", "-o", "/proc/new"),
        ("render", "SCENE", "--path", "orbit", "--steps", "1", "--size", "32", "24", "-o", "/proc/self/new.mp4"),
        ("pack", "SCENE", "-o", "/proc/self/new.4dv"),
        ("export", "SCENE", "--to", "ply", "-o", "/proc/new"),
        ("web", "SCENE", "-o", "/proc/self/new"),
        ("synth", "/proc/new", "--frames", "1", "--cameras", "3", "--size", "32"),
    ],
    ids=lambda words: f"{words[0]} {words[-1]}",
)
def test_a_folder_without_files_is_one_line(
    words: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches the traceback of a FileNotFoundError for an output in /proc, where no file can be created."""
    scene = tmp_path / "scene.4dv"
    write_scene(scene, points=20)
    assert main([str(scene) if word == "SCENE" else word for word in words]) == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith(f"fourd {words[0]}: ")]
    assert len(lines) == 1
    assert "/proc" in lines[0]
