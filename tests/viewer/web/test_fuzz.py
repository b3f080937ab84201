"""The reader of the web player, run by Node on scenes that are damaged at random."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from fourd.viewer.publish.site import write_scene
from tests.baking.scenes import write_full_scene
from tests.baking.scenes import write_scene as write_random_scene

PROGRAM = Path(__file__).parent / "fuzz" / "run.mjs"
MOST_MEMORY = 2**30
"""Limit of the memory in bytes. The largest damaged member expands to 64 MiB."""


@pytest.fixture(scope="module")
def scenes(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Small intact scenes: with source views, with a background and shadows, and without source views."""
    if shutil.which("node") is None:
        pytest.skip("no node here")
    folder = tmp_path_factory.mktemp("fuzz")
    write_random_scene(folder / "random.4dv", views=4, frames=2, points=60)
    write_full_scene(folder / "random_full.4dv", points=50, background_points=80)
    found = [folder / f"{name}.4dv" for name in ("stream", "full", "light")]
    write_scene(folder / "random.4dv", found[0], "stream")
    write_scene(folder / "random_full.4dv", found[1], "full")
    write_scene(folder / "random.4dv", found[2], "light")
    return found


def fuzz(scenes: list[Path], seed: int, cases: int) -> None:
    """Read damaged scenes. Raises AssertionError if the result of a case is neither a scene nor a clear message."""
    words = ["node", "--expose-gc", str(PROGRAM), str(seed), str(cases), *map(str, scenes)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60 + cases)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    repeat = f"seed {seed}; to repeat a case: node {PROGRAM} {seed} =CASE {' '.join(map(str, scenes))}"
    print(f"{repeat}\n{done.stdout}")
    assert done.returncode == 0, f"{repeat}\n{done.stdout[-2000:]}{done.stderr[-2000:]}"
    assert [line for line in lines if "problem" in line] == [], repeat
    total = lines[-1]
    assert total["read"] + total["refused"] == cases
    # Some damaged scenes are still valid. The other scenes reach many different checks.
    assert total["read"] > 0.03 * cases
    assert total["messages"] > 30
    assert total["peakMemory"] < MOST_MEMORY


def test_damaged_scenes_end_with_a_clear_message(scenes: list[Path], rng: np.random.Generator) -> None:
    """Catches damaged scenes that make the reader hang, take too much memory, fail without a clear message, or return
    wrong arrays."""
    fuzz(scenes, int(rng.integers(2**31)), 500)


@pytest.mark.slow
def test_many_damaged_scenes_end_with_a_clear_message(scenes: list[Path], rng: np.random.Generator) -> None:
    """Catches the errors of :func:`test_damaged_scenes_end_with_a_clear_message`, with 10,000 scenes instead of 500."""
    fuzz(scenes, int(rng.integers(2**31)), 10_000)


def test_the_program_reports_problems(scenes: list[Path], tmp_path: Path) -> None:
    """Catches a fuzz program that reports no problem for a faulty reader."""
    root = PROGRAM.parents[4]
    for folder in ("viewer/web", "tests/viewer/web/fuzz"):
        shutil.copytree(root / folder, tmp_path / folder, ignore=shutil.ignore_patterns("node_modules"))
    inflate = tmp_path / "viewer" / "web" / "decode" / "inflate.js"
    text = inflate.read_text()
    changed = text.replace("if (content.length !== size)", "if (false)")
    assert changed != text
    inflate.write_text(changed)
    program = tmp_path / "tests" / "viewer" / "web" / "fuzz" / "run.mjs"
    done = subprocess.run(["node", program, "1", "400", *scenes], capture_output=True, text=True)
    assert '"problem"' in done.stdout
