"""Commands on random captures: each succeeds, or refuses its input with one line. None ends with a traceback.

Every run has new seeds, from FOURD_TEST_SEED=N on, which pytest prints at its start. Setting it repeats the captures.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.random_captures.commands import run_all
from tests.random_captures.recipes import draw_recipe
from tests.random_captures.write import write_random

SHORT, LONG = 8, 300
SMALL = (48, 64)


def check_seed(seed: int, folder: Path, *, is_small: bool) -> None:
    print(f"the seed of this capture: {seed}")
    recipe = draw_recipe(seed, max_cameras=4, sizes=SMALL) if is_small else draw_recipe(seed)
    outcomes = run_all(write_random(folder / "source", recipe), recipe)
    improper = [outcome for outcome in outcomes if not outcome.is_proper]
    shown = "\n".join(f"fourd {each.command}: exit code {each.code}\n{each.message}" for each in improper)
    assert not improper, f"{recipe}\n{shown}"


@pytest.mark.parametrize("number", range(SHORT))
def test_small_random_captures(number: int, tmp_path: Path) -> None:
    """Catches errors of OpenCV, COLMAP and SciPy that only some captures cause, such as !model.empty()."""
    check_seed(int(os.environ["FOURD_TEST_SEED"]) + number, tmp_path, is_small=True)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(LONG))
def test_random_captures(number: int, tmp_path: Path) -> None:
    """Catches the same errors in larger captures."""
    check_seed(int(os.environ["FOURD_TEST_SEED"]) + number, tmp_path, is_small=False)


def test_a_synthetic_capture_that_crashed(tmp_path: Path) -> None:
    """Catches the traceback of fourd check on a plain synthetic capture, run from outside."""
    for words in (
        ["synth", "capture", "--frames", "4", "--cameras", "8", "--size", "192", "--seed", "0"],
        ["check", "capture"],
    ):
        command = [sys.executable, "-m", "fourd", *words]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert "Traceback" not in done.stderr
